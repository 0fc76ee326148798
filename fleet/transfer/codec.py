"""How are bytes packed for a robot? The only place that knows zstd.

From Python 3.14 on zstd is in the library; before, backports.zstd is the same module under another name.

The packed bytes depend on the bytes alone, not on the pieces they come in or on how many processors there are: a
transfer that one desktop began is gone on with by another, which packs the layer once more. Only another version of zstd
may pack differently; the digest then differs too, and the layer is sent from its first byte.
"""

from __future__ import annotations

import sys
import zlib
from typing import TYPE_CHECKING, Literal, Protocol

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

Encoding = Literal["zstd-long", "zstd", "gzip"]
"""``zstd-long`` finds repetitions 64 MiB apart, and who unpacks it needs several times as much memory; ``zstd`` finds them
8 MiB apart."""

ENCODINGS: tuple[Encoding, ...] = ("zstd-long", "zstd", "gzip")

LEVEL = 6
"""Of zstd, for layers, whatever the link: a layer that one desktop has packed has the same digest on another one.

Level 3 would be twice as quick and a little larger, 9 a little smaller, with much more memory.
"""

PATCH_LEVEL = 3
"""Of zstd, for patches, which are nearly as small then, and made while somebody waits."""

SHORTEST_REFERENCE = 8
"""Bytes; zstd takes nothing shorter for a dictionary."""

TRAINED = b"\x37\xa4\x30\xec"
"""How a trained dictionary begins (RFC 8878, section 6), which a reference must not."""

DAMAGED = (zlib.error, zstd.ZstdError)
"""What is raised of packed bytes that are not right."""

_WINDOW_LOG: Mapping[Encoding, int] = {"zstd-long": 26, "zstd": 23}
_LARGEST_WINDOW_LOG = 27  # 128 MiB: the most that `zstd -d` accepts without being told to
_WORKERS = 2  # any number above none gives the same bytes; none at all gives others
_GZIP = 31  # zlib's word for the largest window in a gzip container; its header carries no time
_BLOCK = 1 << 20  # bytes
_GZIP_MAGIC, _ZSTD_MAGIC = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"


class _Engine(Protocol):
    def compress(self, data: bytes, /) -> bytes: ...

    def flush(self) -> bytes: ...


class _Unpacker(Protocol):
    @property
    def eof(self) -> bool: ...

    @property
    def unused_data(self) -> bytes: ...

    def decompress(self, data: bytes, /) -> bytes: ...


class Compressor:
    """One stream of packed bytes: `compress` any number of times, then `flush` once."""

    def __init__(self, encoding: Encoding, *, level: int = LEVEL) -> None:
        """``level`` is zstd's; gzip, which serves robots without zstd, stays at 6."""
        self._engine = _engine(encoding, level)
        self._held = bytearray()

    def compress(self, data: bytes) -> bytes:
        """Take more bytes; return what is packed of all so far, which may be nothing yet.

        The engine always gets whole blocks: then it cannot tell which pieces they came in.
        """
        self._held += data
        whole = len(self._held) - len(self._held) % _BLOCK
        with memoryview(self._held) as held:
            packed = b"".join(
                self._engine.compress(bytes(held[at : at + _BLOCK])) for at in range(0, whole, _BLOCK)
            )
        del self._held[:whole]
        return packed

    def flush(self) -> bytes:
        """Return the rest. Nothing can be packed after it."""
        rest = self._engine.compress(bytes(self._held)) + self._engine.flush()
        self._held.clear()
        return rest


def _engine(encoding: Encoding, level: int) -> _Engine:
    if encoding == "gzip":
        return zlib.compressobj(6, zlib.DEFLATED, _GZIP)
    parameter = zstd.CompressionParameter
    return zstd.ZstdCompressor(
        options={
            parameter.compression_level: level,
            parameter.window_log: _WINDOW_LOG[encoding],
            parameter.enable_long_distance_matching: 1,
            parameter.nb_workers: _WORKERS,
        }
    )


def is_packed(first: bytes) -> bool:
    """Whether bytes that begin so are packed, with gzip (RFC 1952) or zstd (RFC 8878)."""
    return first.startswith((_GZIP_MAGIC, _ZSTD_MAGIC))


def inflater(first: bytes) -> Callable[[bytes], bytes]:
    """What unpacks a stream that begins so, piece by piece; plain bytes stay as they are. Raises `DAMAGED`."""
    if first.startswith(_GZIP_MAGIC):
        return _Inflater(lambda: zlib.decompressobj(_GZIP))
    if first.startswith(_ZSTD_MAGIC):
        return _Inflater(
            lambda: zstd.ZstdDecompressor(
                options={zstd.DecompressionParameter.window_log_max: _LARGEST_WINDOW_LOG}
            )
        )
    return bytes


class _Inflater:
    """Unpacks what may be several streams, one after the other: some builders pack each file of a layer for itself."""

    def __init__(self, make: Callable[[], _Unpacker]) -> None:
        self._make = make
        self._one = make()

    def __call__(self, data: bytes) -> bytes:
        plain = []
        while data:
            if self._one.eof:
                self._one = self._make()
            plain.append(self._one.decompress(data))
            data = self._one.unused_data
        return b"".join(plain)


def packed_against(reference: bytes, data: bytes, *, level: int = PATCH_LEVEL) -> bytes:
    """Pack ``data`` into a frame that says only what ``reference`` does not: ``zstd -d -D REFERENCE`` undoes it.

    The frame carries a checksum, so that another reference is noticed. Who unpacks it needs memory for both.

    Raises:
        ValueError: the reference is shorter than `SHORTEST_REFERENCE`, and not empty, or begins as a trained
            dictionary does: zstd would take it for one.

    """
    if reference and (len(reference) < SHORTEST_REFERENCE or reference.startswith(TRAINED)):
        raise ValueError("zstd cannot refer to these bytes")
    parameter = zstd.CompressionParameter
    compressor = zstd.ZstdCompressor(
        options={
            parameter.compression_level: level,
            # The window reaches from the end of the data back to the reference's first byte.
            parameter.window_log: min(
                max(10, (len(reference) + len(data)).bit_length()), _LARGEST_WINDOW_LOG
            ),
            parameter.enable_long_distance_matching: 1,
            parameter.checksum_flag: 1,
        },
        zstd_dict=zstd.ZstdDict(reference, is_raw=True).as_prefix if reference else None,
    )
    # All at once: then the frame tells its size, and the robot's window is no larger than that.
    return compressor.compress(data, mode=zstd.ZstdCompressor.FLUSH_FRAME)
