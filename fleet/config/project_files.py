"""Which files of a project travel to a robot, and which of its paths are the robot's own data?

Everything that a stack mounts from its project's folder is one of three:

``files``  mounted read-only and there on this computer: a part of the release, replaced with it.
``seeds``  mounted writable and there: the robot's data from the first ship on. A changed file is merged as dpkg merges
           configuration files: what the robot has changed is kept.
``folders``  mounted and not there: the robot's data, an empty folder at first.

A folder travels like a file, with its mode: also an empty one, and one that is open to all because a container writes to
it as somebody else.

A read-only mount that shares a path with a writable one is data too, or the two containers would not see the same files.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from pathspec import GitIgnoreSpec

from fleet.config.compose import sources
from fleet.errors import ComposeError
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from fleet.config.compose import Project
    from fleet.config.stack import Mount, Stack

LIMIT = 100_000_000
"""Bytes of one mounted path. More belongs into the image, which is sent by layers, or onto the robot."""

IGNORE = ".fleetignore"
"""Names what of a mounted folder stays here, in the syntax of ``.gitignore``."""

GIVEN = PurePosixPath("files")
"""Where the files of the inventory (``files:``) are in the project's folder."""

UP = "_up"
"""Stands for ``..`` in paths on the robot, of files that the inventory allows from outside the project's folder."""


@dataclass(frozen=True, kw_only=True)
class File:
    """A file that travels: its bytes, or the target of a symbolic link, or a folder; ``mode`` as ``chmod`` writes it."""

    data: bytes = b""
    link: str | None = None
    mode: int = 0o644
    folder: bool = False

    @property
    def regular(self) -> bool:
        """Whether it is neither a link nor a folder."""
        return self.link is None and not self.folder

    @property
    def digest(self) -> str:
        """What it is recognized by: its bytes, its mode or its target."""
        kind = "folder" if self.folder else self.link
        return hashlib.sha256(repr((self.data, kind, self.mode)).encode()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class ProjectFiles:
    """What travels, by its path below the project's folder on the robot."""

    files: Mapping[str, File] = field(default_factory=dict)
    seeds: Mapping[str, File] = field(default_factory=dict)
    folders: tuple[str, ...] = ()
    data: frozenset[str] = frozenset()


def on_robot(path: PurePosixPath) -> str:
    """A path from the project's folder as it is called on the robot: ``../config`` is ``_up/config``."""
    return "/".join(UP if part == ".." else part for part in path.parts) or "."


def collect(
    stack: Stack,
    project: Project,
    *,
    allowed: Iterable[Path] = (),
    given: Mapping[str, File] | None = None,
) -> ProjectFiles:
    """Read what a stack mounts from its project.

    ``allowed`` are the folders outside the project's folder whose files may travel. ``given`` are files that the
    inventory adds to the project, by their path in it.

    Raises:
        ComposeError: a path leaves the project, is missing, cannot be read, or is too large; all of them at once.

    """
    writable = {mount.path for mount in stack.mounts if not mount.read_only}
    data = {mount.path for mount in stack.mounts if any(_shares(mount.path, other) for other in writable)}
    collector = _Collector(project, allowed=tuple(path.resolve() for path in allowed), data=data)
    collector.files |= given or {}
    for mount in stack.mounts:
        if not any(PurePosixPath(name).is_relative_to(mount.path) for name in given or {}):
            collector.add(mount)
    if collector.problems:
        raise ComposeError("\n".join(dict.fromkeys(collector.problems)))
    return ProjectFiles(
        files=collector.files,
        seeds=collector.seeds,
        folders=tuple(sorted(collector.folders)),
        data=frozenset(on_robot(path) for path in data),
    )


def _shares(one: PurePosixPath, other: PurePosixPath) -> bool:
    return one.is_relative_to(other) or other.is_relative_to(one)


class _Collector:
    """Reads mounts one after the other; each path once."""

    def __init__(self, project: Project, *, allowed: tuple[Path, ...], data: set[PurePosixPath]) -> None:
        self.files: dict[str, File] = {}
        self.seeds: dict[str, File] = {}
        self.folders: set[str] = set()
        self.problems: list[str] = []
        self._project = project
        self._allowed = allowed
        self._data = data
        self._done: set[PurePosixPath] = set()
        ignore = project.real / IGNORE
        lines = ignore.read_text(encoding="utf-8", errors="replace").splitlines() if ignore.is_file() else []
        self._ignored = GitIgnoreSpec.from_lines(lines)

    def add(self, mount: Mount) -> None:
        """Read what one mount shows; what is wrong with it goes to ``problems``."""
        if mount.path in self._done:
            return
        self._done.add(mount.path)
        here = Path(os.path.normpath(self._project.real / mount.path))
        try:
            self._look(mount, here)
        except OSError as problem:
            self._problem(
                mount, f"cannot be read: {problem.filename}: {problem.strerror}", "see its permissions"
            )

    def _look(self, mount: Mount, here: Path) -> None:
        # A symbolic link leaves it as `..` does.
        leaves = ".." in mount.path.parts or not here.resolve().is_relative_to(self._project.real)
        if leaves and not self._may_leave(here):
            self._problem(
                mount, "leaves the project's folder", "move it into the folder, or allow it with `outside:`"
            )
        elif not here.exists():
            self._missing(mount)
        else:
            self._read(mount, here)

    def _may_leave(self, here: Path) -> bool:
        return here.exists() and any(here.resolve().is_relative_to(folder) for folder in self._allowed)

    def _missing(self, mount: Mount) -> None:
        if mount.kind != "bind":
            self._problem(mount, "is not there", "make the file, or correct its name")
        elif mount.path == GIVEN and mount.path not in self._data:
            self.files[on_robot(mount.path)] = _FOLDER  # the inventory has no files for this robot
        elif mount.must_exist:
            self._problem(
                mount,
                "is not there, and `create_host_path: false` says that it must be",
                "make it here, or remove that line",
            )
        elif mount.path not in self._data:
            self._problem(
                mount,
                "is not there, and is mounted read-only: it would be an empty folder for ever",
                "make the file, or correct its name",
            )
        elif mount.path.suffix and PurePosixPath(mount.target).suffix:
            self._problem(
                mount,
                "is not there, and looks like a file",
                "make the file; for a folder of the robot, `mkdir` it here",
            )
        else:
            self.folders.add(on_robot(mount.path))

    def _read(self, mount: Mount, here: Path) -> None:
        size, name = 0, on_robot(mount.path)
        into = self.seeds if mount.path in self._data else self.files
        if here.is_dir():
            self.folders |= {name} if mount.path in self._data else set()
            into[name] = _file(here.resolve())
            for path in self._walk(here):
                if not _printable(path.name):
                    what = f"has a name that cannot travel: {path.name!a}"
                    self._problem(mount, what, f"rename it, or name it in {IGNORE}")
                    continue
                below = path.relative_to(here).as_posix()
                size += self._size(path)
                if size > LIMIT:
                    break
                into[f"{name}/{below}".removeprefix("./")] = _file(path)
        elif not stat.S_ISREG(here.stat().st_mode):
            self._problem(
                mount, "is neither a file nor a folder", "name it by its absolute path if it is the robot's"
            )
            return
        else:
            size = self._size(here)
            if size <= LIMIT:
                into[name] = _file(here.resolve())
        if size > LIMIT:
            self._problem(
                mount,
                f"has more than {human_bytes(LIMIT)} ({human_bytes(_total(here))})",
                f"put it into the image, leave it to the robot (absolute path), or name it in {IGNORE}",
            )

    def _walk(self, folder: Path) -> Iterator[Path]:
        for path in sorted(folder.iterdir()):
            below = Path(os.path.relpath(path, self._project.real)).as_posix()
            is_folder = path.is_dir() and not path.is_symlink()
            if self._ignored.match_file(f"{below}/" if is_folder else below):
                continue
            if is_folder:
                yield path
                yield from self._walk(path)
            elif path.is_symlink() or path.is_file():
                yield path

    def _size(self, path: Path) -> int:
        return path.stat().st_size if path.is_file() else 0

    def _problem(self, mount: Mount, what: str, cure: str) -> None:
        self.problems.append(
            f"{self._where(mount)}: services.{mount.service}: {_written(mount.path)} {what}; {cure}"
        )

    def _where(self, mount: Mount) -> str:
        """The line of a Compose file that names the path; without one the first file."""
        written = (str(mount.path), mount.path.name)
        for words in filter(None, written):
            for path in sources(self._project):
                for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
                    if re.search(rf"(?<![\w.-]){re.escape(words)}(?![\w.-])", line.partition(" #")[0]):
                        return f"{path}:{number}"
        return str(self._project.files[0])


def _written(path: PurePosixPath) -> str:
    return str(path) if ".." in path.parts else f"./{path}"


_FOLDER = File(folder=True, mode=0o755)


def _file(path: Path) -> File:
    if path.is_symlink():
        return File(link=str(path.readlink()), mode=0o777)
    mode = path.stat().st_mode
    if path.is_dir():
        return File(folder=True, mode=_mode(mode | 0o100) | mode & stat.S_ISVTX)
    return File(data=path.read_bytes(), mode=_mode(mode))


def _mode(mode: int) -> int:
    """A mode without what depends on the umask of a checkout: private, readable or writable for others; executable or not."""
    letters = 0o4 if mode & 0o4 else 0
    if letters and mode & 0o2:
        letters = 0o6
    everyone = letters * 0o11 | 0o600
    return everyone | (everyone & 0o444) >> 2 if mode & 0o100 else everyone


def _printable(name: str) -> bool:
    """Whether a file's name is UTF-8 and one line: lists of names on the robot have one in each line."""
    return not any(ord(letter) < 0x20 or 0xD800 <= ord(letter) < 0xE000 for letter in name)


def _total(here: Path) -> int:
    paths = here.rglob("*") if here.is_dir() else (here,)
    return sum(path.stat().st_size for path in paths if path.is_file() and not path.is_symlink())
