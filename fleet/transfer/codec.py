"""Pack and unpack bytes for robots: the only module that uses zstd.

From Python 3.14 on zstd is in the standard library; for older versions backports.zstd is the same module.

The packed bytes depend only on the input, not on how it was split or on the number of processors. So a transfer that one
desktop began can resume from another desktop, which packs the same layer again. Only another version of zstd may pack
differently; then the digest differs too, and the layer is sent from its first byte.
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
"""``zstd-long`` finds repetitions 64 MiB apart, and unpacking needs several times as much memory; ``zstd`` finds them 8 MiB
apart."""

ENCODINGS: tuple[Encoding, ...] = ("zstd-long", "zstd", "gzip")

LEVEL = 6
"""The zstd level for layers. It does not depend on the link, so that every desktop packs a layer to the same digest.

Level 3 would be twice as fast and pack a little larger; 9 a little smaller, with much more memory.
"""

PATCH_LEVEL = 3
"""The zstd level for patches: they are nearly as small as with a higher one, and the user waits while they are made."""

SHORTEST_REFERENCE = 8
"""Bytes; zstd refuses a shorter dictionary."""

TRAINED = b"\x37\xa4\x30\xec"
"""The first bytes of a trained dictionary (RFC 8878, section 6); a reference must not begin with them."""

DAMAGED = (zlib.error, zstd.ZstdError)
"""The exceptions for damaged packed bytes."""

_WINDOW_LOG: Mapping[Encoding, int] = {"zstd-long": 26, "zstd": 23}
_LARGEST_WINDOW_LOG = 27  # 128 MiB: the most that `zstd -d` accepts without --memory
_WORKERS = 2  # any number above 0 gives the same bytes; 0 gives others
_GZIP = 31  # zlib's number for the largest window in a gzip container; its header has no time stamp
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
        """Add bytes; return the packed bytes that are complete, which may be none yet.

        The engine always gets whole blocks, so that its output does not depend on how the input was split.
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
        """Return the remaining packed bytes; the compressor cannot be used afterwards."""
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
    """Whether a stream that begins with ``first`` is packed with gzip (RFC 1952) or zstd (RFC 8878)."""
    return first.startswith((_GZIP_MAGIC, _ZSTD_MAGIC))


def inflater(first: bytes) -> Callable[[bytes], bytes]:
    """A function that unpacks a stream that begins with ``first``, chunk by chunk; plain bytes stay as they are.

    The function raises `DAMAGED`.
    """
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
    """Unpack one stream or several in a row: some image builders pack each file of a layer separately."""

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
    """Pack the difference between ``data`` and ``reference`` into a zstd frame; ``zstd -d -D REFERENCE`` unpacks it.

    The frame has a checksum, so that a wrong reference is detected. Unpacking needs memory for both.

    Raises:
        ValueError: the reference is not empty and shorter than `SHORTEST_REFERENCE`, or begins like a trained dictionary,
            which zstd would take it for.

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
    # In one call: then the frame states its size, and the robot's window is no larger than that.
    return compressor.compress(data, mode=zstd.ZstdCompressor.FLUSH_FRAME)
