from __future__ import annotations

import errno
import os
import stat
from typing import TYPE_CHECKING

import pytest

from fleet.card import write
from fleet.card.first_boot import MARK
from fleet.errors import DesktopError

if TYPE_CHECKING:
    from pathlib import Path

OURS = f"#cloud-config\n{MARK}pi7\n"


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


def test_a_card_that_is_pulled_out_has_the_file_or_its_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each sync: a file under its own name is whole, and what was there is whole under one of two names."""
    (tmp_path / "cmdline.txt").write_text("theirs")
    seen = []

    def look(_: int) -> None:
        seen.append({path.name: path.read_text() for path in tmp_path.iterdir()})

    monkeypatch.setattr(os, "fsync", look)
    write.write({"cmdline.txt": "ours"}, folder=tmp_path)
    copy, kept = {"cmdline.txt.before-fleet.new": "theirs"}, {"cmdline.txt.before-fleet": "theirs"}
    assert seen == [
        {"cmdline.txt": "theirs", **copy},
        {"cmdline.txt": "theirs", **kept},
        {"cmdline.txt": "theirs", **kept, "cmdline.txt.new": "ours"},
        {"cmdline.txt": "ours", **kept},
    ]


def test_a_copy_that_was_cut_is_made_again(tmp_path: Path) -> None:
    """The card was pulled out while it was written."""
    (tmp_path / "user-data").write_text("theirs")
    (tmp_path / "user-data.before-fleet.new").write_text("th")
    write.write({"user-data": OURS}, folder=tmp_path)
    assert (tmp_path / "user-data.before-fleet").read_text() == "theirs"


def test_a_file_system_that_cannot_sync_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Then everything is synced, and the card is not called full or locked."""
    real, synced = os.fsync, []

    def fsync(handle: int) -> None:
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "Invalid argument")
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "sync", lambda: synced.append(True))
    assert write.write({"user-data": OURS}, folder=tmp_path) == {"user-data": "written"}
    assert synced


def test_text_of_a_card(tmp_path: Path) -> None:
    """Whatever is in it."""
    (tmp_path / "file").write_bytes(b"a\xff\r\n")
    assert write.text(tmp_path / "file") == "a\ufffd\r\n"
    assert write.text(tmp_path / "nothing") == ""
    with pytest.raises(DesktopError, match="cannot be read"):
        write.text(tmp_path)
