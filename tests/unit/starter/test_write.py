from __future__ import annotations

import resource
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.starter.write import File, planned, write

if TYPE_CHECKING:
    from pathlib import Path

FILES = {"a": File(data=b"1"), "b/c": File(data=b"2", executable=True)}


def test_files_are_written_once(tmp_path: Path) -> None:
    """The second time all of them are there, and stay as they are."""
    assert planned(FILES, folder=tmp_path) == {"a": "written", "b/c": "written"}
    assert write(FILES, folder=tmp_path) == {"a": "written", "b/c": "written"}
    assert ((tmp_path / "a").read_bytes(), (tmp_path / "b/c").read_bytes()) == (b"1", b"2")
    assert ((tmp_path / "a").stat().st_mode & 0o111, (tmp_path / "b/c").stat().st_mode & 0o100) == (0, 0o100)
    (tmp_path / "a").write_bytes(b"mine")
    assert planned(FILES, folder=tmp_path) == write(FILES, folder=tmp_path) == {"a": "kept", "b/c": "kept"}
    assert (tmp_path / "a").read_bytes() == b"mine"


def test_a_link_that_leads_nowhere_is_kept(tmp_path: Path) -> None:
    """Nothing is written through it."""
    (tmp_path / "a").symlink_to("elsewhere")
    assert (
        planned({"a": FILES["a"]}, folder=tmp_path)
        == write({"a": FILES["a"]}, folder=tmp_path)
        == {"a": "kept"}
    )
    assert not (tmp_path / "elsewhere").exists()


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    """In a sentence: a file where a folder should be."""
    (tmp_path / "b").touch()
    with pytest.raises(DesktopError, match="b cannot be written"):
        write(FILES, folder=tmp_path)
    with pytest.raises(DesktopError, match="cannot be written"):
        write({"a": File(data=b"")}, folder=tmp_path / "b")


def test_a_disk_that_fills_up_leaves_no_part_of_a_file(tmp_path: Path) -> None:
    """A part would be kept by the next run."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, hard))
    try:
        with pytest.raises(DesktopError, match="a cannot be written"):
            write({"a": File(data=b"x" * 11)}, folder=tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not (tmp_path / "a").exists()
