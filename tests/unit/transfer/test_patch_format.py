from __future__ import annotations

import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fleet.onboard import rebuild_layer
from fleet.transfer import codec, patch_format
from tests.support.layers import made, noise, segments, tar

MB = 1 << 20


def applied(old: bytes, data: bytes) -> bytes:
    """Read a patch as its module describes it, with zstd's own ``--patch-from``."""
    new = b""
    with TemporaryDirectory() as directory:
        for segment in segments(data):
            reference = old[segment.begin : segment.begin + segment.length]
            assert len(reference) == segment.length
            if not segment.packed:
                new += reference
                continue
            (Path(directory) / "old").write_bytes(reference)
            option = (f"--patch-from={directory}/old",) if reference else ()
            frame = data[segment.at : segment.at + segment.packed]
            new += subprocess.run(
                ("zstd", "-dqc", *option), input=frame, capture_output=True, check=True
            ).stdout
    return new


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Segments and ranges of kilobytes: layers of many segments, in no time."""
    for name, value in (("SEGMENT", 24 << 10), ("RANGE", 32 << 10), ("_MARGIN", 4 << 10)):
        monkeypatch.setattr(patch_format, name, value)


def files(count: int, size: int = 5_000) -> dict[str, bytes]:
    return {f"usr/lib/{number:03}": noise(number, size) for number in range(count)}


@pytest.mark.parametrize(
    ("old", "new"),
    [(b"", b""), (b"", b"new"), (b"old", b""), (b"old", b"new"), (b"same", b"same"), (b"x" * 8, b"x" * 9)],
)
def test_no_tar_at_all(old: bytes, new: bytes) -> None:
    """Whatever the two are, the patch makes one of the other."""
    assert applied(old, made(old, new)) == new


def test_the_head_tells_both_sizes() -> None:
    """So a patch that was cut, or meets another layer, is noticed at once."""
    assert made(b"old", b"brand new").startswith(b"fleet-patch 1 3 9\n")


@pytest.mark.usefixtures("small")
def test_the_same_layer_costs_headers_only() -> None:
    """Each segment is a copy, so nothing is packed and nothing has to be unpacked."""
    layer = tar(files(40))
    assert all(not segment.packed for segment in segments(made(layer, layer)))
    assert len(made(layer, layer)) < 400


@pytest.mark.usefixtures("small")
def test_a_file_more_costs_that_file() -> None:
    """What comes after it has moved, and is found where it was."""
    old = files(40)
    new = dict(sorted((old | {"usr/lib/007a": noise("new", 30_000)}).items()))
    data = made(tar(old), tar(new))
    assert applied(tar(old), data) == tar(new)
    assert 30_000 < len(data) < 33_000
    assert sum(not segment.packed for segment in segments(data)) >= 5


@pytest.mark.usefixtures("small")
def test_a_file_less_costs_next_to_nothing() -> None:
    """The other direction."""
    old = files(40)
    new = {name: content for name, content in old.items() if not "010" < name[-3:] < "020"}
    data = made(tar(old), tar(new))
    assert applied(tar(old), data) == tar(new)
    assert len(data) < 3_000


@pytest.mark.usefixtures("small")
def test_other_times_cost_the_headers() -> None:
    """A layer that was built again has the same files with other times."""
    data = made(tar(files(40)), tar(files(40), time=7.25))
    assert applied(tar(files(40)), data) == tar(files(40), time=7.25)
    assert len(data) < 6_000


@pytest.mark.usefixtures("small")
def test_files_in_another_order_are_found_as_far_as_a_range_reaches() -> None:
    """The range is where most of the segment's bytes were, not where the first of its files was."""
    old = files(60)
    names = list(old)
    names.insert(0, names.pop(59))  # alone far away from those that follow it
    new = {name: old[name] for name in names}
    data = made(tar(old), tar(new))
    assert applied(tar(old), data) == tar(new)
    assert len(data) < 5_000 + 3_000


@pytest.mark.usefixtures("small")
def test_a_file_larger_than_a_segment_is_followed_inside() -> None:
    """A byte more near its begin moves all the rest of it; so does what comes before the file."""
    content = noise("large", 200_000)
    old = tar({"a": noise("a", 10_000), "model": content, "z": b"z"})
    new = tar({"model": content[:1000] + b"!" + content[1000:], "z": b"z"})
    data = made(old, new)
    assert applied(old, data) == new
    assert len(data) < 3_000


@pytest.mark.usefixtures("small")
def test_a_file_that_grew_at_its_begin_is_followed_from_its_end() -> None:
    """Where from its begin nothing fits, from its end all does."""
    content = noise("large", 200_000)
    old, new = tar({"log": content}), tar({"log": noise("more", 7_000) + content})
    data = made(old, new)
    assert applied(old, data) == new
    assert len(data) < 7_000 + 5_000


@pytest.mark.usefixtures("small")
def test_a_broken_tar_is_aligned_by_position() -> None:
    """Bytes that are no tar cost what changed, as long as they have not moved far."""
    old = noise("bytes", 150_000)
    new = old[:70_000] + b"changed" + old[70_000:]
    data = made(old, new)
    assert applied(old, data) == new
    assert len(data) < 2_000


@pytest.mark.usefixtures("small")
def test_a_tar_that_breaks_off_is_used_as_far_as_it_goes() -> None:
    """Nothing is lost by a layer that Python cannot read to its end."""
    old = tar(files(20))
    new = old[:60_000] + b"\xff" * 3_000 + old[60_000:]
    assert applied(old, made(old, new)) == new
    assert applied(new, made(new, old)) == old


def test_a_range_that_looks_like_a_dictionary_is_not_referred_to() -> None:
    """zstd would take it for a trained one, and refuse it."""
    old = codec.TRAINED + noise("old", 1000)
    assert applied(old, made(old, old + b"!")) == old + b"!"


def test_robots_know_the_format() -> None:
    """The program there imports nothing of ours, so it says the same again."""
    assert (rebuild_layer.MAGIC, rebuild_layer.HEADER.format) == (
        patch_format.MAGIC,
        patch_format.HEADER.format,
    )
    assert (rebuild_layer.SEGMENT, rebuild_layer.RANGE) == (patch_format.SEGMENT, patch_format.RANGE)
    assert patch_format.RANGE <= 32 * MB, "zstd takes no larger dictionary"


NAMES = st.text("abc/", min_size=1, max_size=4).filter(lambda name: name.strip("/"))
TREES = st.dictionaries(NAMES, st.tuples(st.integers(0, 5), st.integers(0, 60_000)), max_size=8)


@pytest.mark.usefixtures("small")
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    TREES, TREES, st.lists(st.tuples(st.integers(0, 300_000), st.integers(0, 3_000), st.binary(max_size=20)))
)
def test_any_two_layers(
    before: dict[str, tuple[int, int]],
    after: dict[str, tuple[int, int]],
    edits: list[tuple[int, int, bytes]],
) -> None:
    """Files that come, go, grow and shrink, and edits that respect no border, headers included."""
    old, new = (tar({name: noise(*file) for name, file in tree.items()}) for tree in (before, before | after))
    for at, cut, more in edits:
        new = new[:at] + more + new[at + cut :]
    data = made(old, new)
    assert applied(old, data) == new
    for segment in segments(data):
        assert segment.new_length <= patch_format.SEGMENT
        assert segment.length <= patch_format.RANGE
