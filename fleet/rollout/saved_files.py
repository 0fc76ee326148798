"""Which files are in the folders that somebody works in, and when does one of them change? The only module that imports watchfiles.

An event only says that it is time to look: the folders are then read again and compared. So it does not matter how an editor
saves a file, and 5,000 files at once are one look.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import queue
import stat
import threading
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from watchfiles import watch

from fleet.errors import DesktopError
from fleet.plan.watch import Entry
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from fleet.config.watch import Rule

    Stamp = tuple[int, int, int, int]

LARGEST = 1_000_000_000
"""Bytes of a file that is synced; a larger one belongs into an image, which is sent by layers."""

MOST = 50_000
"""Files that are followed: more are a mistake in a path, and each look would take seconds."""

QUIET, AT_MOST = 0.1, 1.0
"""Seconds: without another event, a change counts as over; under constant changes, this often is looked."""

_STEP = 20
"""Milliseconds that watchfiles gathers events, twice; its own limit does not hold for one file that changes all the time."""

_LOOK_AGAIN = 2000
"""Milliseconds without an event after which the files are looked at all the same: an event before the watch began is lost."""

_POLL = 1.0
"""Seconds between two looks if the system cannot tell of changes."""

_FRESH = 0.05
"""Seconds: a file that was written so short before may be written again without another time of change."""


class SavedFiles:
    """The files that some rules are about. ``note`` is told, once each, what is not synced."""

    def __init__(self, rules: Sequence[Rule], *, note: Callable[[str], None]) -> None:
        self._rules = rules
        self._note = note
        self._noted: set[str] = set()
        self._known: dict[str, tuple[Stamp, Entry]] = {}

    def look(self) -> dict[str, Entry]:
        """Read the folders. A file is read again only if its time, size, mode or inode have changed.

        Raises:
            DesktopError: there are too many files.

        """
        found: dict[str, Entry] = {}
        for path in self._walk():
            if not any(rule.takes(path) for rule in self._rules):
                continue
            if entry := self._entry(path):
                found[path] = entry
            if len(found) > MOST:
                raise DesktopError(
                    f"`develop.watch` is about more than {MOST} files",
                    cure="name smaller folders, or use `ignore:`",
                )
        self._known = {path: known for path, known in self._known.items() if path in found}
        return found

    def _walk(self) -> Iterator[str]:
        for root in _outermost(rule.path for rule in self._rules):
            if not Path(root).is_dir():
                yield root
                continue
            for folder, folders, names in os.walk(root):
                folders[:] = [name for name in folders if not self._prunes(f"{folder}/{name}")]
                yield from (f"{folder}/{name}" for name in names)
                yield from (f"{folder}/{name}" for name in folders if Path(folder, name).is_symlink())

    def _prunes(self, folder: str) -> bool:
        about = [rule for rule in self._rules if folder.startswith(f"{rule.path}/")]
        inside = any(rule.path == folder or rule.path.startswith(f"{folder}/") for rule in self._rules)
        return not inside and all(rule.prunes(folder) for rule in about)

    def _entry(self, path: str) -> Entry | None:
        """The file as it is now; None if it is not there any more, or is not synced."""
        try:
            status = os.lstat(path)
            stamp = (status.st_mtime_ns, status.st_size, status.st_mode, status.st_ino)
            known = self._known.get(path)
            if known and known[0] == stamp:
                return known[1]
            entry = self._read(path, status)
        except (OSError, RuntimeError) as problem:  # Python before 3.13 raises the latter for a loop of links
            if not isinstance(problem, FileNotFoundError):
                self._once(
                    f"{path} cannot be read and is not synced: {getattr(problem, 'strerror', problem)}"
                )
            return None
        if entry and time.time() - status.st_mtime > _FRESH:
            self._known[path] = (stamp, entry)
        return entry

    def _read(self, path: str, status: os.stat_result) -> Entry | None:
        if "\n" in path or not path.isprintable():
            return self._left_out(f"{path!r} is not synced, because of its name")
        if stat.S_ISLNK(status.st_mode):
            return self._link(path)
        if not stat.S_ISREG(status.st_mode):
            return self._left_out(f"{path} is not synced: it is neither a file nor a link")
        if status.st_size > LARGEST:
            return self._left_out(
                f"{path} is not synced: it has more than {human_bytes(LARGEST)}; build it into the image"
            )
        with Path(path).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        mode = 0o755 if status.st_mode & 0o100 else 0o644
        return Entry(digest=f"{digest}.{mode:o}", size=status.st_size, mode=mode)

    def _link(self, path: str) -> Entry | None:
        target = str(Path(path).readlink())
        root = next(rule.path for rule in self._rules if rule.takes(path))
        if target.startswith("/") or not Path(path).resolve().is_relative_to(root):
            return self._left_out(f"{path} is not synced: it is a link out of {root}")
        return Entry(
            digest=f"{hashlib.sha256(os.fsencode(target)).hexdigest()}.link", mode=0o777, link=target
        )

    def _left_out(self, text: str) -> Entry | None:
        self._once(text)
        return None

    def _once(self, text: str) -> None:
        if text not in self._noted and len(self._noted) < 100:
            self._noted.add(text)
            self._note(text)

    def changes(self, stop: threading.Event) -> Iterator[None]:
        """Yield whenever something may have changed, until ``stop`` is set."""
        roots = list(_outermost(rule.path for rule in self._rules))
        folders = [root for root in roots if Path(root).is_dir()]
        # Of a file its folder is watched: editors replace files, and the new one would not be watched.
        beside = sorted({str(Path(root).parent) for root in roots if root not in folders})
        events: queue.SimpleQueue[Exception | None] = queue.SimpleQueue()
        for paths, recursive in ((folders, True), (beside, False)):
            if paths:
                target = partial(_watch, paths, recursive=recursive, stop=stop, events=events)
                threading.Thread(target=target, daemon=True).start()
        problem: Exception | None = None
        while not stop.is_set() and problem is None:
            try:
                problem = events.get(timeout=0.5) or _until_quiet(events)
            except queue.Empty:
                continue
            yield None
        if problem is not None:
            self._note(
                f"this computer cannot tell of changes ({problem}): the files are read every second instead"
            )
            yield from _poll(stop)


def _watch(
    paths: Sequence[str],
    *,
    recursive: bool,
    stop: threading.Event,
    events: queue.SimpleQueue[Exception | None],
) -> None:
    try:
        while not stop.is_set():
            inodes = _inodes(paths)
            events.put(None)  # what has changed before the watch began
            for _ in watch(
                *paths,
                watch_filter=None,
                step=_STEP,
                stop_event=stop,
                recursive=recursive,
                raise_interrupt=False,
                ignore_permission_denied=True,
                yield_on_timeout=True,
                rust_timeout=_LOOK_AGAIN,
            ):
                events.put(None)
                if _inodes(paths) != inodes:
                    break  # a folder was removed and made again, as by `git checkout`: the new one is watched
            while None in _inodes(paths) and not stop.wait(_POLL):
                pass
    except (
        OSError,
        RuntimeError,
    ) as problem:  # as when there are more folders than fs.inotify.max_user_watches
        events.put(problem)


def _inodes(paths: Sequence[str]) -> list[int | None]:
    """Which folders these are; None for one that is not there."""
    return [Path(path).stat().st_ino if Path(path).exists() else None for path in paths]


def _until_quiet(events: queue.SimpleQueue[Exception | None]) -> Exception | None:
    """Wait until no more events come; the problem, if that ended the events."""
    end = time.monotonic() + AT_MOST
    with contextlib.suppress(queue.Empty):
        while time.monotonic() < end:
            if problem := events.get(timeout=QUIET):
                return problem
    return None


def _poll(stop: threading.Event) -> Iterator[None]:
    while not stop.wait(_POLL):
        yield None


def _outermost(paths: Iterable[str]) -> Iterator[str]:
    """The paths that are not below another one."""
    every = set(paths)
    yield from sorted(path for path in every if not any(path.startswith(f"{other}/") for other in every))
