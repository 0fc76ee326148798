from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path


def replace(path: Path, data: bytes) -> None:
    argv = ("sh", "-c", onboard.text("replace_file.sh"), "replace_file", str(path))
    subprocess.run(argv, input=data, check=True)


def test_a_file_is_replaced_and_its_first_content_kept(tmp_path: Path) -> None:
    """Twice: the copy is that of what fleet found, and not of what fleet wrote."""
    path = tmp_path / "daemon.json"
    path.write_bytes(b"a person's")
    path.chmod(0o640)
    for data in (b"one", b"two"):
        replace(path, data)
        assert (path.read_bytes(), path.stat().st_mode & 0o777) == (data, 0o640)
    kept = tmp_path / "daemon.json.before-fleet"
    assert (kept.read_bytes(), kept.stat().st_mode & 0o777) == (b"a person's", 0o640)
    assert sorted(tmp_path.iterdir()) == [path, kept]


def test_a_new_file_gets_its_folder(tmp_path: Path) -> None:
    """Nothing was there, and nothing is kept."""
    replace(tmp_path / "etc" / "docker" / "daemon.json", b"{}")
    assert [path.name for path in (tmp_path / "etc" / "docker").iterdir()] == ["daemon.json"]
