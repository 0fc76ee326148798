"""How do changed files travel to robots? As one archive, packed once for all robots that lack the same."""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import tarfile
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.plan.watch import GONE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fleet.plan.watch import Change, Tree

_KEPT = 8
"""Archives that are kept: one for each difference that robots have at one time."""

_SMALL = 16_000_000
"""Bytes of a file that are read at once: an editor may write it meanwhile, and its size is known only afterwards."""

_CHUNK = 1 << 20


@dataclass(frozen=True, kw_only=True)
class Archive:
    """A packed archive: its file here, its SHA-256, its size in bytes, and the changes that it really has."""

    path: Path
    name: str
    size: int
    changes: tuple[Change, ...]

    def chunks(self, offset: int) -> Iterator[bytes]:
        """The bytes from an offset on."""
        with self.path.open("rb") as file:
            file.seek(offset)
            while data := file.read(_CHUNK):
                yield data


class Archives:
    """The archives of one `fab dev`, in a folder of its own. Many threads ask for them; each is packed once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._made: dict[tuple[Change, ...], Archive] = {}
        self._count = 0

    def of(self, changes: tuple[Change, ...], tree: Tree) -> Archive:
        """The archive with some changes. Raises OSError if a file cannot be read any more."""
        with self._lock:
            if changes not in self._made:
                while len(self._made) >= _KEPT:
                    self._made.pop(next(iter(self._made))).path.unlink(missing_ok=True)
                self._count += 1
                self._made[changes] = _pack(changes, tree, self._folder / f"{self._count}.tar.gz")
            return self._made[changes]


def _pack(changes: tuple[Change, ...], tree: Tree, path: Path) -> Archive:
    """Write an archive. Whoever reads ``dev_sync.sh`` finds its form there."""
    with (
        path.open("wb") as file,
        gzip.GzipFile(filename="", mode="wb", compresslevel=1, fileobj=file, mtime=0) as zipped,
        tarfile.open(fileobj=zipped, mode="w|", format=tarfile.PAX_FORMAT, bufsize=_CHUNK) as archive,
    ):
        packed = [_add(archive, change, tree) if change.verb == "put" else change for change in changes]
        plan = "".join(f"{change}\n" for change in packed).encode()
        entry = tarfile.TarInfo("plan")
        entry.size = len(plan)
        archive.addfile(entry, io.BytesIO(plan))
    with path.open("rb") as written:
        name = hashlib.file_digest(written, "sha256").hexdigest()
    return Archive(path=path, name=name, size=path.stat().st_size, changes=tuple(packed))


def _add(archive: tarfile.TarFile, change: Change, tree: Tree) -> Change:
    """Add a file as it is now; the digest of the change becomes that of the bytes that were read."""
    known = tree.get(change.source)
    entry = tarfile.TarInfo(f"files/{change.service}{change.place}")
    if known is None:
        return replace(change, verb="gone", digest=GONE)
    entry.mode = known.mode
    if known.link is not None:
        entry.type, entry.linkname = tarfile.SYMTYPE, known.link
        archive.addfile(entry)
        return change
    with Path(change.source).open("rb") as file:
        status = os.fstat(file.fileno())
        entry.mtime = status.st_mtime
        if status.st_size > _SMALL:
            entry.size = status.st_size
            archive.addfile(entry, file)  # raises OSError if it has become shorter
            return change
        data = file.read(_SMALL + 1)
    entry.size = len(data)
    archive.addfile(entry, io.BytesIO(data))
    return replace(change, digest=f"{hashlib.sha256(data).hexdigest()}.{known.mode:o}")
