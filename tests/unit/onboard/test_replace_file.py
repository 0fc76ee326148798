from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from tests.support.robot_shell import EACH_SHELL

if TYPE_CHECKING:
    from pathlib import Path


def replace(
    path: Path, data: bytes, *, digest: str = "", keep: bool = True, shell: str = "sh", front: str = ""
) -> subprocess.CompletedProcess[bytes]:
    """Run the script with ``data`` as its input; ``digest`` is that of other bytes, ``front`` a folder of programs."""
    run = (
        (shell, "sh") if shell == "busybox" else (shell,),
        ("-c", onboard.text("replace_file.sh"), "replace_file"),
    )
    how = (str(path), digest or hashlib.sha256(data).hexdigest(), *(("keep",) if keep else ()))
    environment = {"PATH": f"{front}:{os.environ['PATH']}"}
    return subprocess.run(
        (*run[0], *run[1], *how), input=data, capture_output=True, check=False, env=environment
    )


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_a_file_is_replaced_and_its_first_content_kept(tmp_path: Path, shell: str) -> None:
    """Twice: the copy is that of what fleet found, and not of what fleet wrote."""
    path = tmp_path / "daemon.json"
    path.write_bytes(b"a person's")
    path.chmod(0o640)
    for data in (b"one", b"two"):
        assert replace(path, data, shell=shell).returncode == 0
        assert (path.read_bytes(), path.stat().st_mode & 0o777) == (data, 0o640)
    kept = tmp_path / "daemon.json.before-fleet"
    assert (kept.read_bytes(), kept.stat().st_mode & 0o777) == (b"a person's", 0o640)
    assert sorted(tmp_path.iterdir()) == [path, kept]


def test_a_new_file_gets_its_folder(tmp_path: Path) -> None:
    """Nothing was there, and nothing is kept."""
    replace(tmp_path / "etc" / "docker" / "daemon.json", b"{}")
    assert [path.name for path in (tmp_path / "etc" / "docker").iterdir()] == ["daemon.json"]


def test_a_file_of_fleets_own_needs_no_copy(tmp_path: Path) -> None:
    path = tmp_path / "boot.sh"
    path.write_bytes(b"of an older version")
    replace(path, b"new", keep=False)
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"boot.sh": b"new"}


@pytest.mark.parametrize("arrived", [b"", b'{"log-dri', b"all of it, and more"])
def test_what_did_not_arrive_whole_is_refused(tmp_path: Path, arrived: bytes) -> None:
    """A lost connection ends the input like a whole one: an empty daemon.json would take a person's settings away."""
    path = tmp_path / "daemon.json"
    path.write_bytes(b"a person's")
    done = replace(path, arrived, digest=hashlib.sha256(b"all of it").hexdigest())
    assert (done.returncode, b"stays as it was" in done.stderr) == (74, True)
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"daemon.json": b"a person's"}
    new = tmp_path / "new.json"
    assert replace(new, arrived, digest=hashlib.sha256(b"all of it").hexdigest()).returncode == 74
    assert not new.exists()


def test_the_copy_is_on_the_disk_before_the_original_goes(tmp_path: Path) -> None:
    """A power cut at any moment leaves one of both: each rename comes after a sync of what it makes visible."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("sync", "mv"):
        real = shutil.which(name)
        (programs / name).write_text(
            f'#!/bin/sh\nprintf "%s" {name} >>{tmp_path}/log\n'
            f'for one; do printf " %s" "${{one##*/}}" >>{tmp_path}/log; done\necho >>{tmp_path}/log\nexec {real} "$@"\n'
        )
        (programs / name).chmod(0o755)
    path = tmp_path / "etc" / "daemon.json"
    path.parent.mkdir()
    path.write_bytes(b"a person's")
    assert replace(path, b"new", front=str(programs)).returncode == 0
    assert (tmp_path / "log").read_text().splitlines() == [
        "sync daemon.json.before-fleet.new",
        "mv daemon.json.before-fleet.new daemon.json.before-fleet",
        "sync etc",
        "sync daemon.json.new",
        "mv daemon.json.new daemon.json",
        "sync etc",
    ]


def test_a_secret_is_never_readable_for_others(tmp_path: Path) -> None:
    """Its mode is set before its content is written; a file that was open to all is closed."""
    (tmp_path / "client.key").write_bytes(b"old")
    (tmp_path / "client.key").chmod(0o644)
    digest = hashlib.sha256(b"secret").hexdigest()
    for name in ("client.key", "new.key"):
        argv = (
            "sh",
            "-c",
            onboard.text("replace_file.sh"),
            "replace_file",
            str(tmp_path / name),
            digest,
            "secret",
        )
        assert subprocess.run(argv, input=b"secret", check=False).returncode == 0
        found = tmp_path / name
        assert (found.read_bytes(), found.stat().st_mode & 0o777) == (b"secret", 0o600)
    assert len(list(tmp_path.iterdir())) == 2
