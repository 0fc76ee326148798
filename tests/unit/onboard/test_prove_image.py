from __future__ import annotations

import hashlib
import io
import json
import os
import subprocess
import tarfile
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path

CONFIG, OTHER = f"sha256:{'c' * 64}", f"sha256:{'d' * 64}"


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


MANIFEST = json.dumps({"config": {"mediaType": "x", "digest": CONFIG, "size": 7}, "layers": []})
INDEX = json.dumps({"manifests": [{"digest": f"sha256:{digest(MANIFEST)}"}]})


def prove(home: Path, *, image_id: str, members: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run it with a Docker that has an image of that ID, and saves these members."""
    programs = home / "bin"
    programs.mkdir()
    with tarfile.open(home / "saved.tar", "w") as archive:
        for name, text in members.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(text)
            archive.addfile(entry, io.BytesIO(text.encode()))
    docker = f'case $1 in image) echo {image_id} ;; save) cat "{home}/saved.tar" ;; esac'
    (programs / "docker").write_text(f"#!/bin/sh\n{docker}\n")
    (programs / "docker").chmod(0o755)
    argv = ("sh", "-c", onboard.text("prove_image.sh"), "prove_image", "talker:fleet-cc", CONFIG, "cc")
    environment = {"HOME": str(home), "PATH": f"{programs}:{os.environ['PATH']}"}
    return subprocess.run(argv, env=environment, capture_output=True, text=True, check=False)


def blob(text: str) -> str:
    return f"blobs/sha256/{digest(text)}"


@pytest.mark.parametrize(
    ("image_id", "members", "code"),
    [
        (CONFIG, {}, 0),
        (OTHER, {}, 1),
        (f"sha256:{digest(MANIFEST)}", {blob(MANIFEST): MANIFEST}, 0),
        (f"sha256:{digest(MANIFEST)}", {}, 1),
        (
            f"sha256:{digest(INDEX)}",
            {blob(INDEX): INDEX, "manifest.json": '[{"Config":"blobs/sha256/' + "c" * 64 + '"}]'},
            0,
        ),
        (
            f"sha256:{digest(INDEX)}",
            {blob(INDEX): INDEX, "manifest.json": '[{"Config":"blobs/sha256/' + "d" * 64 + '"}]'},
            1,
        ),
    ],
)
def test_an_image_is_proved_by_its_configuration(
    tmp_path: Path, image_id: str, members: dict[str, str], code: int
) -> None:
    """Its ID in a classic store; in a containerd store what the manifest of its ID names."""
    done = prove(tmp_path, image_id=image_id, members=members)
    assert done.returncode == code
    assert ("arrived as another image" in done.stderr) == bool(code)
    kept = [path.read_text() for path in tmp_path.glob(".fleet/receipts/*")]
    assert kept == ([MANIFEST] if blob(MANIFEST) in members else [])


def test_a_receipt_saves_the_work(tmp_path: Path) -> None:
    """What came layer by layer has one already."""
    (tmp_path / ".fleet/receipts").mkdir(parents=True)
    (tmp_path / ".fleet/receipts/cc").write_text(MANIFEST)
    assert prove(tmp_path, image_id=f"sha256:{digest(MANIFEST)}", members={}).returncode == 0
