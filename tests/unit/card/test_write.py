from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from fleet.card import cloud_init, write
from fleet.errors import DesktopError

if TYPE_CHECKING:
    from pathlib import Path

OURS = f"#cloud-config\n{cloud_init.MARK}pi7\n"


def test_what_was_there_is_kept_beside(tmp_path: Path) -> None:
    """Once: the second run finds our own file, and nothing to do."""
    (tmp_path / "user-data").write_text("theirs")
    files = {"user-data": OURS, "ssh": ""}
    assert write.planned(files, folder=tmp_path) == {"user-data": "written", "ssh": "written"}
    assert write.write(files, folder=tmp_path) == {"user-data": "written", "ssh": "written"}
    assert write.write(files, folder=tmp_path) == {"user-data": "unchanged", "ssh": "unchanged"}
    changed = OURS + "hostname: pi7\n"
    assert write.write({"user-data": changed}, folder=tmp_path) == {"user-data": "written"}
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "user-data": changed,
        "user-data.before-fleet": "theirs",
        "ssh": "",
    }


def test_a_full_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The old file is still whole, and no part of the new one is left."""
    (tmp_path / "user-data").write_text(OURS)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DesktopError, match=r"user-data cannot be written: No space left on device"):
        write.write({"user-data": OURS + "x"}, folder=tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"user-data": OURS}


def test_text_of_a_card(tmp_path: Path) -> None:
    """Whatever is in it."""
    (tmp_path / "file").write_bytes(b"a\xff\r\n")
    assert write.text(tmp_path / "file") == "a\ufffd\r\n"
    assert write.text(tmp_path / "nothing") == ""
    with pytest.raises(DesktopError, match="cannot be read"):
        write.text(tmp_path)
