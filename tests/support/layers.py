"""What layers and patches are like, for the tests of several modules."""

from __future__ import annotations

import io
import random
import tarfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.transfer import patch_format

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


def tar(files: Mapping[str, bytes], *, time: float = 1.5) -> bytes:
    """A layer's tar with these files, in this order; times that are no whole seconds make headers of their own."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size, member.mtime = len(content), time
            archive.addfile(member, io.BytesIO(content))
    return out.getvalue()


def noise(seed: object, size: int) -> bytes:
    """Bytes that nothing packs, the same for the same seed."""
    return random.Random(str(seed)).randbytes(size)  # noqa: S311 - no secret


def made(old: bytes, new: bytes) -> bytes:
    """The patch between two tars."""
    out = io.BytesIO()
    assert patch_format.make(io.BytesIO(old), io.BytesIO(new), out) == len(out.getvalue())
    return out.getvalue()


@dataclass(frozen=True, kw_only=True)
class Segment:
    """One segment's header, with where its packed bytes are in the patch."""

    begin: int
    length: int
    new_length: int
    packed: int
    at: int


def segments(data: bytes) -> Iterator[Segment]:
    """The segments of a patch."""
    at = data.index(b"\n") + 1
    while at < len(data):
        begin, length, new_length, packed = patch_format.HEADER.unpack_from(data, at)
        at += patch_format.HEADER.size
        yield Segment(begin=begin, length=length, new_length=new_length, packed=packed, at=at)
        at += packed
