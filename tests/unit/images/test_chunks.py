from __future__ import annotations

import io

from fleet.images.chunks import Chunks


def test_chunks_of_any_size_read_as_one_file() -> None:
    """Empty ones too; a reader takes as many bytes at once as it likes."""
    chunks = [b"", b"ab", b"c" * 10, b"", b"d"]
    assert io.BufferedReader(Chunks(chunks), 4).read() == b"".join(chunks)
    file = io.BufferedReader(Chunks(chunks), 4)
    assert [file.read(3), file.read(9), file.read(100), file.read(1)] == [b"abc", b"c" * 9, b"d", b""]
