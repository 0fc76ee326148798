"""How is what ``docker save`` writes read as a file? It comes from the engine in chunks of any size."""

from __future__ import annotations

import io
import tarfile
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

SMALL = 4_000_000
"""Bytes; the configuration of an image is smaller, and so is every other member of an archive that is JSON."""


_BUFFER = 1 << 20  # bytes


class Chunks(io.RawIOBase):
    """Chunks of bytes that can be read as a file."""

    def __init__(self, chunks: Iterable[bytes]) -> None:
        self._chunks = iter(chunks)
        self._rest = b""

    def readable(self) -> bool:
        """See ``io.IOBase.readable``."""
        return True

    def readinto(self, buffer: Any) -> int:  # noqa: ANN401  Python has no name for a buffer before 3.12
        """See ``io.RawIOBase.readinto``."""
        view = memoryview(buffer)
        self._rest = self._rest or next(filter(None, self._chunks), b"")
        count = min(len(view), len(self._rest))
        view[:count] = self._rest[:count]
        self._rest = self._rest[count:]
        return count


def small_members(chunks: Iterable[bytes]) -> dict[str, bytes]:
    """The members of an archive that are small enough to be JSON, by name."""
    stream = io.BufferedReader(Chunks(chunks), _BUFFER)
    with tarfile.open(fileobj=stream, mode="r|", bufsize=_BUFFER) as archive:
        return {
            member.name: content.read()
            for member in archive
            if member.isfile() and member.size <= SMALL and (content := archive.extractfile(member))
        }
