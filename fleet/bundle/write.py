"""Write a bundle to a folder, usually a stick: only what is new, never half, and safe to pull out.

A file is written under another name, synced and renamed. SHA256SUMS is replaced last; what only the older bundle needed
is removed after that.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import re
import shutil
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fleet.errors import DesktopError, UsageError
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Sequence

SUMS = "SHA256SUMS"

PART = 4_000_000_000
"""Bytes of a file at most: FAT32 ends at 4 GiB."""

_CHUNK = 1 << 20
_OURS = re.compile(
    r"(layers|images|releases)/[0-9a-f]{64}(\.[0-9]{2})?|programs-[0-9a-f]{12}/[a-z_0-9]+\.sh"
    r"|index-[0-9a-f]{12}|signed-[0-9a-f]{12}\.sig|install|READ-ME\.txt"
).fullmatch
_MARK = b"fab bundle"
"""What the file ``install`` of a bundle has in its first lines."""


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A file of a bundle: ``size`` bytes from ``offset`` of what ``open`` opens; ``digest`` is their SHA-256 in hex."""

    path: str
    size: int
    digest: str
    open: Callable[[], IO[bytes]]
    offset: int = 0


@dataclass(frozen=True, kw_only=True)
class Written:
    """Files and bytes that were written, and bytes that were there already."""

    files: int
    new: int
    kept: int


def piece(path: str, data: bytes) -> Piece:
    """A small file."""
    digest = hashlib.sha256(data).hexdigest()
    return Piece(path=path, size=len(data), digest=digest, open=lambda: io.BytesIO(data))


def parts(
    path: str, *, size: int, digest: str, source: Callable[[], IO[bytes]], most: int = PART
) -> list[Piece]:
    """A large file, in numbered parts; reads it if there are several."""
    starts = range(0, max(size, 1), most)
    if len(starts) == 1:
        return [Piece(path=f"{path}.01", size=size, digest=digest, open=source)]
    pieces = []
    with source() as content:
        for number, start in enumerate(starts, start=1):
            length = min(most, size - start)
            summed = hashlib.sha256()
            for chunk in _read(content, length):
                summed.update(chunk)
            one = Piece(
                path=f"{path}.{number:02}", size=length, digest=summed.hexdigest(), open=source, offset=start
            )
            pieces.append(one)
    return pieces


def sums(pieces: Iterable[Piece]) -> bytes:
    """The text of SHA256SUMS, as ``sha256sum -c`` reads it."""
    return "".join(f"{one.digest}  {one.path}\n" for one in pieces).encode()


def listed(folder: Path) -> dict[str, str]:
    """The digest of each file of the bundle in a folder, by its name; {} if there is none."""
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (FileNotFoundError, NotADirectoryError, UnicodeDecodeError):
        return {}
    pairs = (line.partition("  ") for line in lines)
    return {name: digest for digest, _, name in pairs if _OURS(name)}


def check_folder(folder: Path) -> None:
    """Check that a folder is there. Raises `UsageError`: a bundle beside a stick that is not mounted helps nobody."""
    if not folder.is_dir():
        cure = "mount the stick; for a folder that is not a stick, create it first"
        raise UsageError(f"there is no folder {folder}", cure=cure)


class Writer:
    """Writes one bundle into a folder.

    ``on_write`` is called with the name and the size of each file before it is written, ``on_bytes`` with the number of
    bytes that were written.
    """

    def __init__(
        self,
        folder: Path,
        *,
        on_write: Callable[[str, int], None] = lambda *_: None,
        on_bytes: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._folder = folder
        self._on_write = on_write
        self._on_bytes = on_bytes

    def plan(self, pieces: Sequence[Piece]) -> list[Piece]:
        """What is not there yet.

        Raises:
            UsageError: the folder is missing, or has a file of that name that is not ours.
            DesktopError: there is not enough room.

        """
        folder = self._folder
        check_folder(folder)
        with self._explained():
            old = listed(folder)
            install = folder / "install"
            if not old and install.exists() and _MARK not in install.read_bytes()[:400]:
                raise UsageError(
                    f"{install} is not a file of fleet, and a bundle would replace it",
                    cure="use another folder, or move that file away",
                )
            new = [one for one in pieces if not _is(folder / one.path, one)]
            # What was cut off goes before anything is written.
            free = shutil.disk_usage(folder).free + sum(map(_size, self._left_over()))
        # A file system gives space in clusters, of up to 64 kB on a large stick.
        needed = sum(one.size + 65_536 for one in new)
        if needed > free:
            earlier = sum(_size(folder / name) for name in old.keys() - {one.path for one in pieces})
            cure = f"{human_bytes(earlier)} belong to the bundle that is there now: " * bool(earlier)
            raise DesktopError(
                f"{folder} has {human_bytes(free)} free, and the bundle needs {human_bytes(needed)}",
                cure=f"{cure}delete what is not needed, or take a larger stick",
            )
        return new

    def write(self, pieces: Sequence[Piece], *, sign: Callable[[bytes], bytes] | None = None) -> Written:
        """Write what is new, make it the bundle of this folder, and remove what only the one before it needed.

        ``sign`` makes a signature of SHA256SUMS; it is asked before anything is written. Raises as `plan`, and `DesktopError` if the stick fails or is full.
        """
        pieces = list({one.path: one for one in pieces}.values())
        new, text = self.plan(pieces), sums(pieces)
        name = f"signed-{hashlib.sha256(text).hexdigest()[:12]}.sig"
        signatures = [piece(name, sign(text))] if sign else []
        keep = {one.path for one in (*pieces, *signatures)}
        with self._explained():
            self._remove(self._left_over())
            old = listed(self._folder)
            for one in new:
                self._on_write(one.path, one.size)
                self._put(one)
            for one in (*signatures, piece(SUMS, text)):
                self._put(one)
            outdated = old.keys() - keep
            outdated |= {path.name for path in self._folder.glob("signed-*.sig")} - keep
            self._remove(self._folder / name for name in outdated if _OURS(name))
            for folder in (
                *self._folder.glob("programs-*"),
                *map(self._folder.joinpath, ("layers", "images")),
            ):
                with contextlib.suppress(OSError):
                    folder.rmdir()  # only if it is empty
        written = sum(one.size for one in new)
        return Written(files=len(new), new=written, kept=sum(one.size for one in pieces) - written)

    def _left_over(self) -> list[Path]:
        """Files that an interrupted run has not finished."""
        return [path for path in self._folder.rglob("*.part") if _OURS(self._name(path)[:-5])]

    def _put(self, one: Piece) -> None:
        path = self._folder / one.path
        path.parent.mkdir(exist_ok=True)
        part = path.with_name(f"{path.name}.part")
        try:
            self._copy(one, part)
            part.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
            raise
        _sync(path.parent)

    def _copy(self, one: Piece, part: Path) -> None:
        with one.open() as content, part.open("wb") as out:
            content.seek(one.offset)
            summed = hashlib.sha256()
            for chunk in _read(content, one.size):
                summed.update(chunk)
                out.write(chunk)
                self._on_bytes(len(chunk))
            out.flush()
            os.fsync(out.fileno())
        if summed.hexdigest() != one.digest:
            raise DesktopError(f"{one.path} changed while it was read", cure="run the same command again")

    def _remove(self, paths: Iterable[Path]) -> None:
        for path in paths:
            path.unlink(missing_ok=True)
        _sync(self._folder)

    def _name(self, path: Path) -> str:
        return path.relative_to(self._folder).as_posix()

    @contextlib.contextmanager
    def _explained(self) -> Generator[None]:
        try:
            yield
        except OSError as problem:
            raise _refusal(self._folder, problem) from problem


def write_tar(path: Path, write: Callable[[Path], Written]) -> Written:
    """Write a bundle as one tar archive, for a server or another computer. Raises as `Writer.write`.

    Only its owner can read it: the releases' secrets are in it. (The files of a folder have the modes of the umask, because
    a stick that is not FAT must be read by another user on the robot.)
    """
    check_folder(path.parent)
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as temporary:
            folder, part = Path(temporary, "bundle"), Path(temporary, "tar")
            folder.mkdir()
            written = write(folder)
            part.touch(mode=0o600)
            with tarfile.open(part, "w", format=tarfile.PAX_FORMAT) as archive:
                for name in sorted(one for one in folder.rglob("*") if one.is_file()):
                    archive.add(name, arcname=name.relative_to(folder).as_posix())
            part.replace(path)
        _sync(path.parent)
    except OSError as problem:
        raise _refusal(path, problem) from problem
    return written


def _refusal(where: Path, problem: OSError) -> DesktopError:
    again = "run the same command again: what was written whole is kept"
    match problem.errno:
        case errno.ENOSPC | errno.EDQUOT:
            return DesktopError(f"{where} is full", cure=f"delete what is not needed there; {again}")
        case errno.EROFS | errno.EACCES | errno.EPERM:
            return DesktopError(
                f"{where} cannot be written: {problem.strerror}",
                cure="see whether the stick is write-protected, and mounted for you",
            )
        case _:
            return DesktopError(
                f"writing to {where} failed: {problem.strerror}",
                cure=f"if the stick was pulled out, put it in again; {again}",
            )


def _read(content: IO[bytes], size: int) -> Generator[bytes]:
    """The next ``size`` bytes in chunks; fewer if it ends."""
    while size > 0 and (chunk := content.read(min(size, _CHUNK))):
        size -= len(chunk)
        yield chunk


def _is(path: Path, one: Piece) -> bool:
    """Whether a file is there with the right content: it is read, because sticks lose bytes and people edit."""
    try:
        if path.stat().st_size != one.size:
            return False
        with path.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest() == one.digest
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return False


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _sync(folder: Path) -> None:
    with contextlib.suppress(OSError):  # not every file system can
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
