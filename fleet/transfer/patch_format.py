r"""Make patches: what has changed inside a layer, from its old tar to its new one.

The new tar is cut into segments. Each is packed against a range of the old tar that is small enough for a robot's memory
and holds the old versions of the segment's files. A patch consists of, in order::

    fleet-patch 1 OLD_SIZE NEW_SIZE\n
    for each segment: old offset (8 bytes), old length, new length, packed length (4 bytes each), the packed bytes

Numbers are big-endian. Packed bytes are one zstd frame whose reference is the old range; a packed length of 0 means that
the segment equals the old range. On the robot `fleet.onboard.rebuild_layer` reads the patch.
"""

from __future__ import annotations

import io
import struct
import tarfile
from bisect import bisect_right
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING

from fleet.transfer import codec

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MAGIC = "fleet-patch 1"
HEADER = struct.Struct(">QIII")

SEGMENT = 24 << 20
"""Bytes of the new tar that are packed at once. Together with `RANGE` it determines the robot's memory: 150 MB in all."""

RANGE = 32 << 20
"""Bytes of the old tar that a segment may refer to: the largest dictionary that the zstd command accepts."""

_MARGIN = 4 << 20  # bytes around the matched files: files of other names may be similar


@dataclass(frozen=True, kw_only=True)
class _Pair:
    """A member that both tars have: its begin and end, header included, in the new tar and in the old one."""

    new: int
    new_end: int
    old: int
    old_end: int


def make(old: IO[bytes], new: IO[bytes], out: IO[bytes], *, level: int = codec.PATCH_LEVEL) -> int:
    """Write the patch that turns ``old`` into ``new``, both seekable; return its size in bytes.

    The patch is right whatever the two contain; it is small if both are tars with similar members.
    """
    pairs = _pairs(old, new)
    old_size, new_size = _size(old), _size(new)
    written = out.write(f"{MAGIC} {old_size} {new_size}\n".encode())
    for start in range(0, new_size, SEGMENT):
        data = _read(new, start, min(SEGMENT, new_size - start))
        touched = _touched(pairs, start, start + len(data))
        same = start + (touched[0].old - touched[0].new if touched else 0)
        if 0 <= same <= old_size - len(data) and _read(old, same, len(data)) == data:
            written += out.write(HEADER.pack(same, len(data), len(data), 0))
            continue
        spans = tuple(_spans(touched, start, start + len(data)))
        begin, end = _range(spans or (_around(pairs, start),), old_size)
        reference = _read(old, begin, end - begin)
        if len(reference) < codec.SHORTEST_REFERENCE or reference.startswith(codec.TRAINED):
            reference = b""
        packed = codec.packed_against(reference, data, level=level)
        written += out.write(HEADER.pack(begin, len(reference), len(data), len(packed)) + packed)
    return written


def _size(file: IO[bytes]) -> int:
    return file.seek(0, io.SEEK_END)


def _read(file: IO[bytes], start: int, count: int) -> bytes:
    file.seek(start)
    return file.read(count)


def _pairs(old: IO[bytes], new: IO[bytes]) -> list[_Pair]:
    """The members that both tars have under the same name, in the order of the new tar."""
    there = {name: (start, end) for name, start, end in _members(old)}
    return [
        _Pair(new=start, new_end=end, old=there[name][0], old_end=there[name][1])
        for name, start, end in _members(new)
        if name in there
    ]


def _members(file: IO[bytes]) -> list[tuple[str, int, int]]:
    """Name, begin and end of each member of a tar; in a broken tar of those before the first unreadable one."""
    members = []
    try:
        file.seek(0)
        with tarfile.open(fileobj=file, mode="r:") as archive:
            for member in archive:
                members.append((member.name, member.offset, archive.offset))
                # tarfile remembers every member, and a layer may have a hundred thousand.
                archive.members = []  # type: ignore[attr-defined]
    except (tarfile.TarError, ValueError, OverflowError, EOFError):
        pass
    return members


def _before(pairs: Sequence[_Pair], position: int) -> int:
    """The number of pairs that begin at or before ``position`` of the new tar."""
    return bisect_right(pairs, position, key=lambda pair: pair.new)


def _touched(pairs: Sequence[_Pair], start: int, end: int) -> Sequence[_Pair]:
    """The pairs that have bytes between two positions of the new tar."""
    first = max(0, _before(pairs, start) - 1)
    return [pair for pair in pairs[first : _before(pairs, end - 1)] if pair.new_end > start]


def _around(pairs: Sequence[_Pair], start: int) -> tuple[int, int]:
    """A guess at the old range of a segment without common members: after the last common member before it."""
    before = _before(pairs, start)
    begin = pairs[before - 1].old_end if before else start
    return begin, begin + SEGMENT


def _spans(touched: Sequence[_Pair], start: int, end: int) -> Iterator[tuple[int, int]]:
    """The ranges of the old tar that correspond to the members' bytes between two positions of the new tar.

    A member whose size has changed may have lost or gained bytes anywhere, so its bytes are counted both from its begin
    and from its end.
    """
    for pair in touched:
        head, tail = max(0, start - pair.new), max(0, pair.new_end - end)
        length = pair.new_end - pair.new - head - tail
        from_begin = min(pair.old + head, pair.old_end)
        yield from_begin, min(from_begin + length, pair.old_end)
        from_end = max(pair.old_end - tail, pair.old)
        if from_end - length != from_begin:
            yield max(from_end - length, pair.old), from_end


def _range(spans: Sequence[tuple[int, int]], old_size: int) -> tuple[int, int]:
    """Begin and end of at most `RANGE` bytes of the old tar that hold most of the spans."""
    begin, end = _densest(sorted(spans))
    margin = min(_MARGIN, (RANGE - (end - begin)) // 2)
    return max(0, min(begin - margin, old_size)), min(end + margin, old_size)


def _densest(spans: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Begin and end of the run of spans (ordered by begin) that holds the most bytes and fits into `RANGE`."""
    best, first, held = (0, 0, 0), 0, 0
    for begin, end in spans:
        held += end - begin
        while end - spans[first][0] > RANGE:
            held -= spans[first][1] - spans[first][0]
            first += 1
        best = max(best, (held, spans[first][0], end))
    return best[1], best[2]
