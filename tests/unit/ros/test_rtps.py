from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.ros import rtps, rtps_discovery
from fleet.ros.rtps import Acknack, Data, Fragment, Gap, Heartbeat
from tests.support import recorded

ME, PEER = b"\1\x42" + bytes(range(10)), b"\1\x0f" + bytes(range(10, 20))
HERE = ("10.0.0.9", 40_000)


def parts(datagram: bytes) -> tuple[rtps.Part, ...]:
    packet = rtps.read(datagram)
    assert packet
    return packet.parts


def part(kind: int, body: bytes, flags: int = 1) -> bytes:
    """A datagram with one part, written here and not by the code under test; big endian without flag 1."""
    order = "<" if flags & 1 else ">"
    return b"RTPS\2\3\1\x0f" + PEER + struct.pack(f"{order}BBH", kind, flags, len(body)) + body


@pytest.mark.parametrize("name", recorded.NAMES)
def test_announcements_of_real_participants(name: str) -> None:
    """Vendor, domain and where a participant receives."""
    first = recorded.datagrams(name)[0]
    (data,) = parts(first)
    assert isinstance(data, Data)
    assert data.writer == rtps.ANNOUNCER
    said = rtps_discovery.participant(data.payload, prefix=first[8:20])
    assert said.vendor == ("Fast DDS" if name.startswith("fast") else "Cyclone DDS")
    assert (said.prefix, said.domain, said.secured) == (first[8:20], 0, False)
    assert {address for address, _ in (*said.meta, *said.data)} == {recorded.ROBOT}
    assert said.lease in (10.0, 20.0)


@pytest.mark.parametrize("name", recorded.NAMES)
def test_publishers_of_real_participants(name: str) -> None:
    """Topics with their types, and what a publisher offers."""
    found = {}
    for datagram in recorded.datagrams(name):
        for data in parts(datagram):
            if isinstance(data, Data) and data.writer == rtps.PUBLICATIONS:
                writer = rtps_discovery.endpoint(data.payload, publishes=True)
                assert writer
                found[writer.topic] = writer
    time, latched = found["rt/time"], found["rt/map"]
    assert (time.type, time.quality.reliable, time.keeps) == (
        "builtin_interfaces::msg::dds_::Time_",
        True,
        False,
    )
    assert (latched.type, latched.quality.reliable, latched.keeps) == (
        "std_msgs::msg::dds_::String_",
        True,
        True,
    )


def test_big_endian() -> None:
    """A processor may write numbers the other way round."""
    body = b"\0\0\0\x10" + bytes(4) + rtps.ANNOUNCER + struct.pack(">iI", 1, 7) + b"abcd"
    assert parts(part(0x15, body, flags=4)) == (
        Data(writer=rtps.ANNOUNCER, number=(1 << 32) + 7, payload=b"abcd"),
    )


def test_a_fragment() -> None:
    """The pieces of a large message say where they belong."""
    body = (
        b"\0\0\x1c\0" + bytes(4) + b"\0\0\1\3" + struct.pack("<iIIHHI", 0, 5, 3, 1, 1000, 2500) + b"x" * 500
    )
    assert parts(part(0x16, body)) == (
        Fragment(writer=b"\0\0\1\3", number=5, first=3, size=1000, total=2500, payload=b"x" * 500),
    )


def test_what_a_writer_has_and_has_not() -> None:
    """Heartbeats and gaps."""
    ids = bytes(4) + rtps.PUBLICATIONS
    heartbeat = ids + struct.pack("<iIiII", 0, 2, 0, 9, 1)
    assert parts(part(0x07, heartbeat)) == (
        Heartbeat(writer=rtps.PUBLICATIONS, first=2, last=9, final=False),
    )
    assert parts(part(0x07, heartbeat, flags=3))[0] == Heartbeat(
        writer=rtps.PUBLICATIONS, first=2, last=9, final=True
    )
    gap = ids + struct.pack("<iIiII", 0, 2, 0, 4, 0)
    assert parts(part(0x08, gap)) == (Gap(writer=rtps.PUBLICATIONS, first=2, base=4),)


def test_the_end_of_a_publisher() -> None:
    """Its identity is in the quality of service before the payload, or in the key after it."""
    guid = PEER + b"\0\0\1\3"
    status = struct.pack("<HH", 0x71, 4) + b"\0\0\0\3"
    key_hash = struct.pack("<HH", 0x70, 16) + guid
    end = struct.pack("<HH", 1, 0)
    key = b"\0\3\0\0" + struct.pack("<HH", 0x5A, 16) + guid + end
    head = b"\0\0\x10\0" + bytes(4) + rtps.PUBLICATIONS + struct.pack("<iI", 0, 3)
    for body in (head + key_hash + status + end, head + status + end + key):
        (data,) = parts(part(0x15, body, flags=1 | 2 | 8))
        assert isinstance(data, Data)
        assert (data.gone, data.payload) == (guid, b"")


def test_our_announcement_can_be_read() -> None:
    """What is written here is read as it was meant."""
    (data,) = parts(rtps.announcement(ME, domain=7, place=HERE))
    assert isinstance(data, Data)
    said = rtps_discovery.participant(data.payload, prefix=ME)
    assert (said.prefix, said.domain, said.meta, said.data, said.lease) == (ME, 7, (HERE,), (HERE,), 20.0)


def test_our_subscription_asks_for_little_or_for_the_past() -> None:
    """Best effort fits every publisher; only who wants old messages must be reliable."""
    for durable in (False, True):
        asked = rtps.subscription(ME, number=1, topic="rt/time", kind="T", durable=durable, place=HERE)
        (data,) = parts(rtps.to(ME, PEER, asked))
        assert isinstance(data, Data)
        said = rtps_discovery.endpoint(data.payload, publishes=False)
        assert said
        assert (said.topic, said.type, said.quality.reliable, bool(said.quality.durability)) == (
            "rt/time",
            "T",
            durable,
            durable,
        )
        assert said.guid == ME + rtps.reader(1)


def test_our_farewell() -> None:
    """Others forget the participant."""
    (data,) = parts(rtps.farewell(ME))
    assert isinstance(data, Data)
    assert data.gone[:12] == ME


@given(st.integers(1, 1 << 40), st.sets(st.integers(0, 255)), st.booleans())
def test_missing_numbers_are_bits(base: int, offsets: set[int], final: bool) -> None:
    """From the first one on, the most significant bit first."""
    missing = {base + offset for offset in offsets}
    said = rtps.acknack(
        rtps.PUBLICATIONS_READER, rtps.PUBLICATIONS, base=base, missing=missing, count=1, final=final
    )
    assert bool(said[1] & 2) == final
    high, low, bits = struct.unpack_from("<iII", said, 12)
    words = struct.unpack_from(f"<{-(-bits // 32)}I", said, 24)
    assert (high << 32) + low == base
    assert {base + i for i in range(bits) if words[i // 32] >> (31 - i % 32) & 1} == missing
    assert parts(rtps.to(ME, PEER, said))[-1] == Acknack(writer=rtps.PUBLICATIONS, base=base)


HEADER = st.just(b"RTPS\2\3\1\x0f" + PEER)
PART = st.builds(
    lambda kind, flags, length, body: struct.pack("<BBH", kind, flags, length or len(body)) + body,
    st.sampled_from([0x01, 0x06, 0x07, 0x08, 0x09, 0x0E, 0x15, 0x16]) | st.integers(0, 255),
    st.integers(0, 255),
    st.just(0) | st.integers(0, 65535),
    st.binary(max_size=80),
)


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A real datagram with some bytes changed, cut anywhere."""
    datagram = bytearray(
        draw(st.sampled_from([d for name in recorded.NAMES for d in recorded.datagrams(name)]))
    )
    for _ in range(draw(st.integers(0, 8))):
        datagram[draw(st.integers(0, len(datagram) - 1))] = draw(st.integers(0, 255))
    return bytes(datagram[: draw(st.integers(0, len(datagram)))])


HOSTILE = (
    st.binary(max_size=200)
    | st.builds(lambda h, p: h + b"".join(p), HEADER, st.lists(PART, max_size=5))
    | damaged()
)


@given(HOSTILE)
def test_anything(datagram: bytes) -> None:
    """Whatever arrives: an answer no larger than the datagram, and no exception."""
    packet = rtps.read(datagram)
    if packet is None:
        return
    assert len(packet.parts) <= len(datagram) // 4
    for data in packet.parts:
        if isinstance(data, Data):
            rtps_discovery.participant(data.payload, prefix=packet.prefix)
            rtps_discovery.endpoint(data.payload, publishes=True)
            assert len(data.payload) <= len(datagram)


def test_a_list_of_parameters_without_end() -> None:
    """A length of zero still takes a step."""
    endless = b"\0\3\0\0" + struct.pack("<HH", 0x50, 0) * 10_000
    assert rtps_discovery.parameters(endless).raw(0x50) == b""
    assert rtps_discovery.endpoint(endless, publishes=True) is None


@pytest.mark.parametrize("high", [-1, -(1 << 31), 0x7FFFFFFF])
def test_numbers_that_no_writer_gets_to(high: int) -> None:
    """A part with one is left out: the next number could not be answered."""
    number = struct.pack("<iI", high, 0xFFFFFFFF)
    one = struct.pack("<iI", 0, 1)
    assert parts(part(0x15, b"\0\0\x10\0" + bytes(8) + number, 5)) == ()
    assert parts(part(0x07, bytes(8) + number + number)) == ()
    assert parts(part(0x07, bytes(8) + one + number)) == ()
    assert parts(part(0x08, bytes(8) + one + number)) == ()
    assert parts(part(0x06, bytes(8) + number)) == ()
