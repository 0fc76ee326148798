from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.ros import cdr, rtps, rtps_graph, topics
from fleet.ros.rtps_graph import Graph, Received
from tests.support import recorded
from tests.support.ros2_peer import (
    END,
    PUBLICATIONS,
    SUBSCRIPTIONS,
    WRITER,
    announcement,
    data,
    datagram,
    fragments,
    gone,
    heartbeat,
    parameter,
    publication,
    string,
    string_message,
    submessage,
)

if TYPE_CHECKING:
    from fleet.ros.rtps_discovery import Place

ME, PEER, OTHER = b"\1\x42" + bytes(10), b"\1\x0f" + bytes(range(10)), b"\1\x0f" + bytes(range(1, 11))
STRING = "std_msgs::msg::dds_::String_"
ROBOT, HERE, THERE = "10.0.0.2", ("10.0.0.9", 40_000), ("10.0.0.2", 7410)


def subscription(number: int, topic: str = "rt/chatter", kind: str = STRING, **quality: bytes) -> bytes:
    """A subscriber of the robot, reliable unless said otherwise."""
    said = parameter(0x5A, PEER + bytes((0, 1, number, 4))) + parameter(0x05, string(topic))
    said += parameter(0x07, string(kind)) + parameter(
        0x1A, quality.get("reliability", struct.pack("<IiI", 2, 0, 0))
    )
    return data(SUBSCRIPTIONS, number, b"\0\3\0\0" + said + END)


def graph(topic: str = "/chatter", *, robot: str = ROBOT, place: Place = HERE) -> Graph:
    return Graph(prefix=ME, domain=0, place=place, addresses=(robot,), topic=topic)


def hear(
    listener: Graph, *datagrams: bytes, source: str = ROBOT, now: float = 0, multicast: bool = False
) -> list[tuple[bytes, Place]]:
    """The answers to some datagrams."""
    return [
        answer
        for one in datagrams
        for answer in listener.receive(one, source=source, multicast=multicast, now=now)
    ]


def found(topic: str = "/chatter", *, durable: bool = False) -> Graph:
    """A listener that has found a publisher of its topic."""
    listener = graph(topic)
    hear(
        listener,
        announcement(PEER, THERE),
        datagram(PEER, publication(PEER, 1, f"rt{topic}", durable=durable)),
    )
    assert listener.publishers()
    return listener


def payloads(listener: Graph) -> list[bytes]:
    taken = [message.payload for message in listener.messages]
    listener.messages.clear()
    return taken


@pytest.mark.parametrize(
    ("name", "topic", "kind", "value"),
    [
        ("fast_dds_time", "/time", "builtin_interfaces/Time", None),
        ("cyclone_time", "/time", "builtin_interfaces/Time", None),
        ("fast_dds_map", "/map", "std_msgs/String", "latched"),
        ("cyclone_map", "/map", "std_msgs/String", "latched"),
    ],
)
def test_messages_of_real_publishers(name: str, topic: str, kind: str, value: str | None) -> None:
    """What Fast DDS and Cyclone DDS sent to a listener arrives, in order and once."""
    listener = graph(topic, robot=recorded.ROBOT)
    hear(listener, *recorded.datagrams(name), source=recorded.ROBOT)
    assert {cdr.type_name(message.type) for message in listener.messages} == {kind}
    taken = payloads(listener)
    assert len(taken) == (1 if value else 3)
    if value:
        assert taken == [string_message(value)]
    else:
        seconds = [struct.unpack_from("<I", payload, 4)[0] for payload in taken]
        assert seconds == sorted(seconds)
    assert [peer.knows_us for peer in listener.peers.values()] == [True]


def test_a_participant_is_asked_at_once() -> None:
    """It gets our announcement, and the question for its publishers, where it says that it receives."""
    answers = hear(graph(), announcement(PEER, THERE))
    assert {place for _, place in answers} == {THERE}
    kinds = [part for said, _ in answers for part in rtps.read(said).parts]  # type: ignore[union-attr]
    assert isinstance(kinds[0], rtps.Data)
    assert kinds[1] == rtps.Acknack(writer=rtps.PUBLICATIONS, base=1)


def test_the_subscription_follows_the_publisher() -> None:
    """Its type is only known then. It is repeated until the participant has it."""
    listener = graph()
    hear(listener, announcement(PEER, THERE))
    answers = hear(listener, datagram(PEER, publication(PEER, 1, "rt/chatter")))
    assert any(b"rt/chatter\0" in said for said, _ in answers)
    assert any(b"rt/chatter\0" in said for said, _ in listener.repeat(now=1))
    numbers = struct.pack("<iII", 0, 2, 0) + struct.pack("<I", 1)
    hear(listener, datagram(PEER, submessage(0x06, b"\0\0\4\xc7\0\0\4\xc2" + numbers)))
    assert list(listener.repeat(now=1)) == []


def test_a_publisher_of_another_topic_gets_no_subscription() -> None:
    """Its messages are not taken for the topic's."""
    listener = graph()
    hear(listener, announcement(PEER, THERE))
    assert hear(listener, datagram(PEER, publication(PEER, 1, "rt/chat"))) == []
    hear(listener, datagram(PEER, data(WRITER, 1, string_message("x"))))
    assert payloads(listener) == []
    assert [writer.topic for writer in listener.writers.values()] == ["rt/chat"]


def test_other_computers_of_the_domain_are_left_alone() -> None:
    """Many robots may share a domain; each one's messages are shown under its own name."""
    listener = graph()
    assert hear(listener, announcement(OTHER, ("10.0.0.3", 7410)), source="10.0.0.3") == []
    assert (listener.peers, listener.strangers) == ({}, {OTHER: "10.0.0.3"})
    hear(listener, announcement(PEER, THERE, domain=7))
    assert listener.peers == {}


def test_a_robot_with_two_addresses() -> None:
    """A datagram may come from the other one: the announcement names both."""
    listener = graph()
    answers = hear(listener, announcement(PEER, THERE), source="192.168.7.7")
    assert {place for _, place in answers} == {THERE}
    listener = graph()
    answers = hear(listener, announcement(PEER, ("172.17.0.1", 7410)))
    assert {place for _, place in answers} == {("172.17.0.1", 7410)}  # it names no other


def test_lost_and_doubled_messages() -> None:
    """What is lost does not hold up what follows; what comes again is not shown again."""
    listener = found()
    one, two, three = (datagram(PEER, data(WRITER, n, string_message(str(n)))) for n in (5, 7, 6))
    hear(listener, one, one, two, three, two)
    assert payloads(listener) == [string_message("5"), string_message("7")]


def test_old_messages_are_asked_for_if_the_publisher_keeps_them() -> None:
    """A heartbeat names them; other publishers' heartbeats are not answered."""
    beat = datagram(PEER, heartbeat(WRITER, 3, 4))
    assert hear(found(), beat) == []
    listener = found(durable=True)
    ((said, place),) = hear(listener, beat)
    assert place == THERE
    assert rtps.read(said).parts == (rtps.Acknack(writer=WRITER, base=3),)  # type: ignore[union-attr]
    assert said[-8:-4] == struct.pack("<I", 0b11 << 30)  # 3 and 4
    hear(listener, datagram(PEER, data(WRITER, 4, b"b")), datagram(PEER, data(WRITER, 3, b"a")))
    assert payloads(listener) == [b"b", b"a"]


def test_an_answer_is_not_answered_for_ever() -> None:
    """Cyclone DDS answers each acknack that is not final with a heartbeat: that would go round in circles."""
    listener = found()
    ((said, _),) = hear(listener, datagram(PEER, heartbeat(PUBLICATIONS, 1, 1)))
    assert said[36 + 1] & 2
    assert hear(listener, datagram(PEER, heartbeat(PUBLICATIONS, 1, 1, final=True))) == []
    ((said, _),) = hear(listener, datagram(PEER, heartbeat(PUBLICATIONS, 1, 2, final=True)))
    assert rtps.read(said).parts == (rtps.Acknack(writer=PUBLICATIONS, base=2),)  # type: ignore[union-attr]


def test_a_gap_is_not_waited_for() -> None:
    """A publisher that has ended leaves a number that never comes."""
    listener = found()
    gap = submessage(0x08, bytes(4) + PUBLICATIONS + struct.pack("<iIiII", 0, 2, 0, 4, 0))
    ((said, _),) = hear(listener, datagram(PEER, gap), datagram(PEER, heartbeat(PUBLICATIONS, 1, 4)))
    assert rtps.read(said).parts == (rtps.Acknack(writer=PUBLICATIONS, base=4),)  # type: ignore[union-attr]
    far = submessage(0x08, bytes(4) + PUBLICATIONS + struct.pack("<iIiII", 0, 2, 0x7FFFFFFF, 4, 0))
    hear(listener, datagram(PEER, far))


def test_a_large_message_comes_in_pieces() -> None:
    """In any order, and twice; nothing is shown before all are there."""
    listener = found()
    whole = string_message("x" * 10_000)
    pieces = [datagram(PEER, piece) for piece in fragments(WRITER, 1, whole, 1000)]
    hear(listener, *reversed(pieces[1:]), pieces[3])
    assert payloads(listener) == []
    assert listener.incomplete == len(whole)
    hear(listener, pieces[0], *pieces)
    assert payloads(listener) == [whole]


def test_pieces_that_contradict_each_other_make_no_message() -> None:
    """Overlaps, holes and other sizes are left out, and the next message is not disturbed."""
    listener = found()
    hole = [
        submessage(
            0x16,
            b"\0\0\x1c\0" + bytes(4) + WRITER + struct.pack("<iIIHHI", 0, 1, first, 1, 4, 8) + b"abcdefgh",
        )
        for first in (2, 3)
    ]
    hear(listener, *(datagram(PEER, piece) for piece in hole))
    assert payloads(listener) == []
    hear(listener, *(datagram(PEER, piece) for piece in fragments(WRITER, 2, b"12345678", 4)))
    assert payloads(listener) == [b"12345678"]


def test_pieces_are_no_more_than_their_message() -> None:
    """Thousands that overlap are not kept: the memory is that of the message."""
    pieces = rtps_graph.Pieces(size=1, total=100_000)
    for first in range(1, 20_000):
        part = rtps.Fragment(
            writer=WRITER, number=1, first=first, size=1, total=100_000, payload=bytes(60_000)
        )
        assert pieces.add(part) == b""
        assert sum(map(len, pieces.found.values())) <= 160_000


def test_a_message_that_is_too_large_is_not_collected() -> None:
    """Its size is told."""
    listener = found()
    head = b"\0\0\x1c\0" + bytes(4) + WRITER + struct.pack("<iIIHHI", 0, 1, 1, 1, 4, 0xFFFFFFFF)
    hear(listener, datagram(PEER, submessage(0x16, head + b"abcd")))
    assert (listener.incomplete, payloads(listener)) == (0xFFFFFFFF, [])


def test_a_publisher_that_ends() -> None:
    """It is a publisher no more; its participant still is one, until it says otherwise, or falls silent."""
    listener = found()
    hear(listener, datagram(PEER, gone(PUBLICATIONS, 2, PEER + WRITER)))
    assert (listener.publishers(), len(listener.peers)) == ([], 1)
    hear(listener, datagram(PEER, gone(rtps.ANNOUNCER, 2, PEER + b"\0\0\1\xc1")))
    assert listener.peers == {}
    listener = found()
    list(listener.repeat(now=20))
    assert listener.peers
    list(listener.repeat(now=21))
    assert (listener.peers, listener.writers) == ({}, {})


def test_nobody_speaks_for_another() -> None:
    """A participant cannot announce, end or publish for one with another prefix."""
    listener = found()
    hear(listener, datagram(OTHER, gone(PUBLICATIONS, 1, PEER + WRITER)))
    hear(listener, announcement(OTHER, THERE), datagram(OTHER, publication(PEER, 1, "rt/evil")))
    hear(listener, datagram(OTHER, gone(PUBLICATIONS, 2, PEER + WRITER)))
    assert [writer.topic for writer in listener.writers.values()] == ["rt/chatter"]
    hear(listener, datagram(OTHER, announcement(PEER, ("6.6.6.6", 1))[20:]))
    assert listener.peers[PEER].about.meta == (THERE,)


def test_multicast_is_noticed() -> None:
    """`fab listen` says when only this computer, which knows the address, hears a robot."""
    listener = graph()
    hear(listener, announcement(PEER, THERE))
    assert not listener.peers[PEER].by_multicast
    hear(listener, announcement(PEER, THERE), multicast=True)
    assert listener.peers[PEER].by_multicast


def test_goodbye() -> None:
    """Each participant hears it."""
    ((said, place),) = found().leave()
    (part,) = rtps.read(said).parts  # type: ignore[union-attr]
    assert isinstance(part, rtps.Data)
    assert (part.gone[:12], place) == (ME, THERE)


@given(st.lists(st.integers(1, 60) | st.tuples(st.integers(0, 70)), max_size=60))
def test_received_numbers(events: list[int | tuple[int]]) -> None:
    """As a plain set of numbers would do it."""
    received, there, before = Received(), set[int](), 1
    for event in events:
        if isinstance(event, tuple):
            received.skip_to(event[0])
            before = max(before, event[0])
        else:
            assert received.add(event) == (event >= before and event not in there)
            there.add(event)
    base, missing = received.missing(60)
    expected = {number for number in range(before, 61) if number not in there}
    assert missing == expected
    assert base == min(expected | {base})


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of participants, strangers, publishers, numbers and fragments only so many are kept."""
    for name in ("MOST_PEERS", "MOST_STRANGERS", "MOST_ENDPOINTS", "MOST_AHEAD", "MOST_FRAGMENTS"):
        monkeypatch.setattr(rtps_graph, name, 5)
    listener = found()
    for number in range(2, 30):
        prefix = b"\1\x0f" + struct.pack("<HQ", 0, number)
        hear(listener, announcement(prefix, THERE))
        hear(listener, announcement(prefix[::-1], ("9.9.9.9", 1)), source="9.9.9.9")
        hear(listener, datagram(PEER, publication(PEER, number, "rt/x", writer=struct.pack(">I", number))))
        hear(listener, datagram(PEER, subscription(number)))
        first = fragments(WRITER, number, bytes(100), 10)
        hear(listener, *(datagram(PEER, piece) for piece in first[:8]))
    assert (len(listener.peers), len(listener.strangers)) == (5, 5)
    assert (len(listener.writers), len(listener.readers)) == (5, 5)
    kept = listener._fragments  # noqa: SLF001  what is kept inside is what this test is about
    assert len(kept) <= rtps_graph.UNFINISHED
    assert all(len(pieces.found) <= 5 for pieces in kept.values())
    received = Received()
    for number in range(10, 30):
        received.add(number)
    assert received.missing(12)[1] == set(range(1, 10))


PARTS = st.sampled_from(
    [
        publication(PEER, 1, "rt/chatter"), publication(PEER, 2, "rt/chatter", durable=True), heartbeat(WRITER, 1, 9),
        heartbeat(PUBLICATIONS, 1, 1 << 31), data(WRITER, 1, b"x"), gone(PUBLICATIONS, 3, PEER + WRITER),
        gone(rtps.ANNOUNCER, 3, PEER + WRITER), *fragments(WRITER, 4, bytes(30), 8), announcement(PEER, THERE)[20:],
        subscription(1), subscription(2, kind="x"), heartbeat(SUBSCRIPTIONS, 1, 1 << 31), gone(SUBSCRIPTIONS, 3, PEER),
    ]
)  # fmt: skip


@given(st.lists(PARTS | st.binary(max_size=60), max_size=12), st.data())
def test_anything(parts: list[bytes], drawn: st.DataObject) -> None:
    """In any order and damaged: answers are few, go to the robot's places, and nothing raises."""
    listener = graph()
    hear(listener, announcement(PEER, THERE))
    for part in parts:
        raw = bytearray(datagram(PEER, part))
        for _ in range(drawn.draw(st.integers(0, 3))):
            raw[drawn.draw(st.integers(20, len(raw) - 1)) if len(raw) > 20 else 0] = drawn.draw(
                st.integers(0, 255)
            )
        answers = hear(listener, bytes(raw))
        assert len(answers) <= 40
    listener.unmatched()
    topics.of_graph(listener, rates={})
    list(listener.follow([writer.topic for writer in listener.writers.values()]))
    list(listener.repeat(now=1))
    list(listener.leave())


def test_a_publisher_that_dies_in_the_middle() -> None:
    """Half a message is none, and is not kept when its publisher is gone; the next one's messages arrive."""
    listener = found()
    half = fragments(WRITER, 1, string_message("x" * 5000), 1000)[:3]
    hear(listener, datagram(PEER, *half))
    assert not listener.messages
    assert listener.incomplete
    hear(listener, datagram(PEER, gone(rtps.ANNOUNCER, 2, PEER + b"\0\0\1\xc1")))
    assert not listener.writers
    assert not listener._fragments  # noqa: SLF001  memory is what this is about
    hear(listener, announcement(OTHER, THERE), datagram(OTHER, publication(OTHER, 1, "rt/chatter")))
    hear(listener, datagram(OTHER, data(WRITER, 1, string_message("noon"))))
    assert payloads(listener) == [string_message("noon")]


def test_subscribers_that_do_not_match() -> None:
    """One that wants more than the publisher offers, and one of another type; each reason once, until they have ended."""
    listener = graph()
    weak = publication(PEER, 1, "rt/chatter", reliable=False)
    hear(listener, announcement(PEER, THERE), datagram(PEER, weak, subscription(1), subscription(2)))
    reason = "it wants reliable messages, and the publisher is best effort"
    assert listener.unmatched() == (reason,)
    hear(listener, datagram(PEER, subscription(3, kind="std_msgs::msg::dds_::Int32_")))
    other = "its type is std_msgs/msg/Int32, and the publisher has std_msgs/msg/String"
    assert listener.unmatched() == (reason, other)
    assert listener.unmatched("rt/other") == ()
    for number in (1, 2, 3):
        hear(listener, datagram(PEER, gone(SUBSCRIPTIONS, number + 3, PEER + bytes((0, 1, number, 4)))))
    assert listener.unmatched() == ()


def test_a_subscriber_needs_one_publisher_that_matches() -> None:
    """Whatever the others offer; without a publisher there is nothing to say."""
    listener = graph()
    hear(listener, announcement(PEER, THERE), datagram(PEER, subscription(1)))
    assert listener.unmatched() == ()
    strong = publication(PEER, 2, "rt/chatter", writer=b"\0\0\2\3")
    hear(listener, datagram(PEER, publication(PEER, 1, "rt/chatter", reliable=False), strong))
    assert listener.unmatched() == ()


def test_following_many_topics() -> None:
    """Each has a reader of its own; the peer knows all of them only when it has acknowledged the last."""
    listener = Graph(prefix=ME, domain=0, place=HERE, addresses=(ROBOT,), counting=True)
    names = [f"rt/t{number}" for number in range(30)]
    found = [
        publication(PEER, number, name, writer=bytes((0, 0, number, 3)))
        for number, name in enumerate(names, start=1)
    ]
    hear(listener, announcement(PEER, THERE), datagram(PEER, *found))
    hear(listener, datagram(PEER, data(bytes((0, 0, 1, 3)), 1, string_message("early"))))
    assert not listener.messages
    sent = list(listener.follow(names))
    readers = {
        part.payload[part.payload.index(ME) + 12 :][:4]
        for raw, _ in sent
        for part in parts(raw)
        if isinstance(part, rtps.Data) and part.writer == SUBSCRIPTIONS
    }
    assert len(readers) == 30
    assert all(len(raw) < 10_000 for raw, _ in sent)
    for base, knows in ((30, False), (31, True)):
        numbers = struct.pack("<iII", 0, base, 0) + struct.pack("<I", 1)
        hear(listener, datagram(PEER, submessage(0x06, b"\0\0\4\xc7" + SUBSCRIPTIONS + numbers)))
        assert listener.peers[PEER].knows_us is knows
    hear(listener, datagram(PEER, data(bytes((0, 0, 2, 3)), 1, string_message("x"))))
    hear(listener, datagram(PEER, *fragments(bytes((0, 0, 3, 3)), 1, string_message("y" * 5000), 1000)))
    assert [message.topic for message in listener.messages] == ["rt/t1", "rt/t2"]


def parts(raw: bytes) -> tuple[rtps.Part, ...]:
    packet = rtps.read(raw)
    assert packet
    return packet.parts
