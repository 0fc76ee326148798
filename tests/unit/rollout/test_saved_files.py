from __future__ import annotations

import os
import shutil
import threading
import time
from typing import TYPE_CHECKING, NoReturn

import pytest

from fleet.config.watch import Patterns, Rule
from fleet.errors import DesktopError
from fleet.plan.watch import changed
from fleet.rollout import saved_files
from fleet.rollout.saved_files import SavedFiles

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class Folder:
    """A folder that somebody works in, and what was said about it."""

    def __init__(self, path: Path) -> None:
        self.path = path / "src"
        self.path.mkdir()
        self.notes: list[str] = []
        rule = Rule(
            service="node", action="sync", path=str(self.path), target="/app", ignored=Patterns(["skip"])
        )
        self.files = SavedFiles([rule], note=self.notes.append)

    def write(self, name: str, text: str = "x") -> Path:
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    def look(self) -> set[str]:
        return {os.path.relpath(path, self.path) for path in self.files.look()}


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


def test_what_is_there(folder: Folder) -> None:
    """Files in folders and links that stay inside; not what is ignored."""
    for name in ("a", "deep/er/b", "skip/c", ".git/d", "e~"):
        folder.write(name)
    (folder.path / "link").symlink_to("a")
    (folder.path / "to-folder").symlink_to("deep")
    assert folder.look() == {"a", "deep/er/b", "link", "to-folder"}
    assert folder.notes == []


def test_a_change_of_content_mode_or_name_is_seen(folder: Folder) -> None:
    """A file that is only touched is the same."""
    for name in ("edited", "mode", "touched", "renamed", "gone"):
        folder.write(name)
    before = folder.files.look()
    time.sleep(0.01)
    folder.write("edited", "y")
    (folder.path / "mode").chmod(0o755)
    (folder.path / "touched").touch()
    (folder.path / "renamed").rename(folder.path / "new name")
    (folder.path / "gone").unlink()
    assert {os.path.basename(path) for path in changed(before, folder.files.look())} == {  # noqa: PTH119
        "edited", "mode", "renamed", "new name", "gone",
    }  # fmt: skip


def test_a_file_that_is_written_twice_in_a_moment(folder: Folder) -> None:
    """Also if neither its size nor, by a coarse clock, its time has changed."""
    path = folder.write("a", "1")
    stamp = path.stat()
    before = folder.files.look()
    path.write_text("2")
    os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert changed(before, folder.files.look()) == {str(path)}


def test_a_file_that_is_not_read_again(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """5,000 files are looked at in a moment."""
    os.utime(folder.write("a"), (1, 1))
    folder.files.look()

    def refuse(*_: object) -> NoReturn:
        raise AssertionError

    monkeypatch.setattr("hashlib.file_digest", refuse)
    assert folder.look() == {"a"}


def test_what_is_not_synced_is_told_once(
    folder: Folder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A link out of the folder, a pipe, a name with a line end, and a file that is too large."""
    (tmp_path / "outside").write_text("secret")
    (folder.path / "out").symlink_to("../outside")
    (folder.path / "absolute").symlink_to(folder.path / "a")
    os.mkfifo(folder.path / "pipe")
    folder.write("two\nlines")
    monkeypatch.setattr(saved_files, "LARGEST", 5)
    folder.write("large", "123456")
    folder.write("a")
    assert folder.look() == {"a"}
    assert folder.look() == {"a"}
    told = sorted(text.partition(" is not synced")[0].rpartition("/")[2] for text in folder.notes)
    assert told == ["absolute", "large", "out", "pipe", "two\\nlines'"]


def test_too_many_files_are_refused(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """A path that is too high up would make each look slow."""
    monkeypatch.setattr(saved_files, "MOST", 2)
    for name in "abc":
        folder.write(name)
    with pytest.raises(DesktopError, match="name smaller folders"):
        folder.look()


@pytest.fixture
def events(folder: Folder) -> Iterator[list[float]]:
    """When it was said that something may have changed."""
    stop, seen = threading.Event(), list[float]()
    ready = threading.Event()

    def follow() -> None:
        for _ in folder.files.changes(stop):
            seen.append(time.monotonic())
            ready.set()

    thread = threading.Thread(target=follow)
    thread.start()
    assert ready.wait(10)
    time.sleep(0.3)  # the watch itself begins a moment later
    seen.clear()
    yield seen
    stop.set()
    thread.join(10)
    assert not thread.is_alive()


def wait(seen: list[float], count: int = 1, within: float = 10.0) -> bool:
    end = time.monotonic() + within
    while len(seen) < count and time.monotonic() < end:
        time.sleep(0.01)
    return len(seen) >= count


def test_a_save_is_an_event(folder: Folder, events: list[float]) -> None:
    """A replaced file and a new folder too."""
    folder.write("a")
    assert wait(events)
    count = len(events)
    folder.write("a.new").replace(folder.path / "a")
    assert wait(events, count + 1)


def test_5000_files_are_few_events(folder: Folder, events: list[float]) -> None:
    """A checkout, or an archive that is unpacked; and removing them."""
    for number in range(5000):
        folder.write(f"{number % 50}/f{number}")
    assert wait(events)
    time.sleep(1.0)
    assert len(events) < 50
    assert len(folder.look()) == 5000
    shutil.rmtree(folder.path / "7")
    assert len(folder.look()) == 4900


def test_a_file_that_is_saved_all_the_time(folder: Folder, events: list[float]) -> None:
    """Every 20 ms for 2 s: it is seen while that lasts, and about once each second."""
    began = time.monotonic()
    while time.monotonic() - began < 2.0:
        folder.write("a", str(time.monotonic()))
        time.sleep(0.02)
    assert wait(events)
    assert events[0] - began < 1.9
    assert len(events) < 6


def test_without_events_the_files_are_read_every_second(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when the system's watches are used up: that is said once."""

    def refuse(*_: object, **__: object) -> NoReturn:
        raise OSError("OS file watch limit reached.")

    monkeypatch.setattr(saved_files, "watch", refuse)
    monkeypatch.setattr(saved_files, "_POLL", 0.01)
    stop = threading.Event()
    changes = folder.files.changes(stop)
    for _ in range(4):
        next(changes)
    stop.set()
    assert list(changes) == []
    (note,) = folder.notes
    assert "OS file watch limit reached" in note
    assert "every second instead" in note
