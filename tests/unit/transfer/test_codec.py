from __future__ import annotations

import gzip
import itertools
import subprocess
from typing import TYPE_CHECKING, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet.transfer import codec
from fleet.transfer.codec import Compressor, Encoding
from tests.support.layers import noise

if TYPE_CHECKING:
    from pathlib import Path

ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)

LAYER = noise(7, 40_000) + bytes(9_000_000) + noise(8, 300_000) * 12
"""What a layer is like: long zeros, and repetitions that are far apart; several jobs for zstd's workers."""


def packed(data: bytes, encoding: Encoding, *, sizes: list[int] | None = None) -> bytes:
    """Pack in chunks of these sizes, over and over; in one chunk without sizes."""
    compressor, out, at = Compressor(encoding), b"", 0
    for size in itertools.cycle(sizes or [max(1, len(data))]):
        if at >= len(data):
            break
        out += compressor.compress(data[at : at + size])
        at += size
    return out + compressor.flush()


def unpacked(data: bytes, *options: str) -> bytes:
    return subprocess.run(("zstd", "-dqc", *options), input=data, capture_output=True, check=True).stdout


@pytest.mark.parametrize(
    "data", [b"", b"x", bytes(1 << 20), LAYER], ids=["nothing", "a byte", "a block", "a layer"]
)
def test_packed_bytes_are_what_they_were(data: bytes) -> None:
    """The programs that robots have unpack every encoding."""
    assert gzip.decompress(packed(data, "gzip")) == data
    assert unpacked(packed(data, "zstd")) == data
    assert unpacked(packed(data, "zstd-long")) == data


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("sizes", [[1 << 20], [65536], [1_000_003], [7, 3_000_000], [9_999_999]])
def test_chunks_do_not_show(encoding: Encoding, sizes: list[int]) -> None:
    """A layer that comes in other chunks, and at another time, is packed into the same bytes."""
    assert packed(LAYER, encoding, sizes=sizes) == packed(LAYER, encoding)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_empty_chunk_does_not_show(encoding: Encoding) -> None:
    """Before the first byte it would otherwise start a frame of unknown size."""
    compressor = Compressor(encoding)
    assert compressor.compress(b"") + compressor.flush() == packed(b"", encoding)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.binary(max_size=300)), st.sampled_from(ENCODINGS))
def test_any_chunks_do_not_show(chunks: list[bytes], encoding: Encoding) -> None:
    """Short ones, empty ones, none at all."""
    compressor = Compressor(encoding)
    inside = b"".join(map(compressor.compress, chunks)) + compressor.flush()
    assert inside == packed(b"".join(chunks), encoding)


def test_gzip_tells_no_time() -> None:
    """The four bytes of the header that may hold it are zero."""
    assert packed(b"x", "gzip")[4:8] == bytes(4)


def test_far_repetitions_cost_next_to_nothing() -> None:
    """16 MB apart is within the long window, and beyond the short one."""
    piece = noise(1, 1 << 20)
    data = piece + bytes(16 << 20) + piece
    assert len(packed(data, "zstd-long")) < 1.1 * len(piece)
    assert len(packed(data, "zstd")) > 1.9 * len(piece)


@pytest.mark.usefixtures("desktop")  # it takes long
def test_a_robot_unpacks_with_the_memory_that_is_promised() -> None:
    """`zstd` needs 8 MiB; the long one 64, which `zstd -d` takes without --memory, and not 32."""
    data = noise(2, 1 << 20) * 20 + bytes(130 << 20)
    unpacked(packed(data, "zstd"), "--memory=8MB")
    unpacked(packed(data, "zstd-long"))
    unpacked(packed(data, "zstd-long"), "--memory=64MB")
    with pytest.raises(subprocess.CalledProcessError):
        unpacked(packed(data, "zstd-long"), "--memory=32MB")


def test_level_is_used() -> None:
    """A higher one packs smaller."""
    compressors = Compressor("zstd", level=1), Compressor("zstd", level=12)
    text = " ".join(map(str, range(200_000))).encode()
    quick, thorough = (len(one.compress(text) + one.flush()) for one in compressors)
    assert thorough < quick


@pytest.mark.parametrize("option", ["-D", "--patch-from"])
def test_a_reference_leaves_only_what_changed(tmp_path: Path, option: str) -> None:
    """20 MB of which one byte changed are some ten kB; both of zstd's ways to name a reference unpack them."""
    old = noise(3, 20 << 20)
    new = old[:5_000_000] + b"!" + old[5_000_000:]
    frame = codec.packed_against(old, new)
    assert len(frame) < 100_000
    (tmp_path / "old").write_bytes(old)
    assert unpacked(frame, option, f"{tmp_path}/old") == new


def test_another_reference_is_noticed(tmp_path: Path) -> None:
    """The checksum sees it where sizes and structure agree."""
    old = noise(4, 1 << 20)
    frame = codec.packed_against(old, old)
    (tmp_path / "other").write_bytes(old[:-1] + bytes([old[-1] ^ 1]))
    with pytest.raises(subprocess.CalledProcessError):
        unpacked(frame, "-D", f"{tmp_path}/other")


def test_no_reference_is_a_frame_like_any_other() -> None:
    """And its size is in it, so that the window is no larger than that."""
    assert unpacked(codec.packed_against(b"", LAYER[:100_000])) == LAYER[:100_000]
    assert unpacked(codec.packed_against(b"", b"abc"), "--memory=1KB") == b"abc"


@pytest.mark.parametrize("reference", [b"seven..", codec.TRAINED + bytes(100)])
def test_a_reference_that_zstd_would_misread_is_refused(reference: bytes) -> None:
    """Too short for it, or like a trained dictionary."""
    with pytest.raises(ValueError, match="cannot refer"):
        codec.packed_against(reference, b"data")
