"""Which participants, publishers and subscribers of one robot has a listener heard, and which messages of some topics?

`Graph` is a listener without sockets: datagrams go in, datagrams to send and messages come out. It joins the domain as a
participant with a reader for each topic that it follows. The readers ask for nothing that a publisher could refuse. Only if
all publishers of a topic keep their messages for those who come later, its reader asks for these too; that needs answers to
their heartbeats.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fleet.ros import quality, rtps
from fleet.ros import rtps_discovery as discovery

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from fleet.ros.rtps import Data, Fragment, Gap, Heartbeat, Packet
    from fleet.ros.rtps_discovery import Endpoint, Participant, Place

    Answers = Iterator[tuple[bytes, Place]]

MOST_PEERS, MOST_STRANGERS, MOST_ENDPOINTS, MOST_TOPICS = 256, 64, 4096, 1000
MOST_AHEAD = 4096
"""Numbers of samples that are remembered beyond a missing one."""
LARGEST_MESSAGE = 64 << 20
"""Bytes; more than any camera image. Larger ones are left out."""
MOST_FRAGMENTS = 65_536
PARTS = 20
"""Parts of a datagram at most: with names of 200 letters each, it has 10 kB then."""
UNFINISHED = 4
"""Messages whose fragments are kept while some are missing: a lost fragment of an older one does not come any more."""


class Received:
    """The numbers of one writer's samples that have arrived, or that will never arrive."""

    def __init__(self) -> None:
        self._before = 1  # all before this one
        self._ahead: set[int] = set()

    def add(self, number: int) -> bool:
        """Add a number; False if it is there already."""
        if number < self._before or number in self._ahead or len(self._ahead) >= MOST_AHEAD:
            return False
        self._ahead.add(number)
        self.skip_to(self._before)
        return True

    def skip_to(self, number: int) -> None:
        """Do not wait for the numbers before this one."""
        self._before = max(self._before, number)
        self._ahead = {ahead for ahead in self._ahead if ahead >= self._before}
        while self._before in self._ahead:
            self._ahead.remove(self._before)
            self._before += 1

    def missing(self, last: int) -> tuple[int, set[int]]:
        """Return the first number that is missing, and the missing numbers up to ``last``: at most 256."""
        numbers = range(self._before, min(last, self._before + 255) + 1)
        return self._before, {number for number in numbers if number not in self._ahead}


@dataclass(kw_only=True)
class Peer:
    """A participant of the robot. ``seen`` is a time in seconds."""

    about: Participant
    source: str
    seen: float
    by_multicast: bool = False
    knows_us: bool = False
    publications: Received = field(default_factory=Received)
    subscriptions: Received = field(default_factory=Received)


@dataclass(kw_only=True)
class Pieces:
    """The fragments of one message: their first pieces, and their bytes, which never are more than its own."""

    size: int
    total: int
    found: dict[int, bytes] = field(default_factory=dict)
    arrived: int = 0

    def add(self, part: Fragment) -> bytes:
        """Add a fragment. Returns the message if it is complete, otherwise b""."""
        if (part.size, part.total) == (self.size, self.total) and len(self.found) < MOST_FRAGMENTS:
            self.arrived += len(part.payload) - len(self.found.get(part.first, b""))
            self.found[part.first] = part.payload
        if self.arrived < self.total:
            return b""
        whole = bytearray()
        for first in sorted(self.found):
            if (first - 1) * self.size != len(whole):
                self.found, self.arrived = {}, 0  # they contradict each other
                return b""
            whole += self.found[first]
        return bytes(whole[: self.total])


@dataclass(frozen=True, kw_only=True)
class Message:
    """One message: its topic and type as DDS names, and its bytes."""

    topic: str
    type: str
    payload: bytes


class Graph:
    """What was heard so far. ``prefix`` (12 bytes) is the listener's own; ``addresses`` are the robot's.

    ``place`` is where the listener receives; ``topic`` is the ROS name of a topic to follow. Times are in seconds.
    ``counting``: messages are counted only, so a large one is a message without bytes as soon as its first part is there.
    """

    def __init__(
        self,
        *,
        prefix: bytes,
        domain: int,
        place: Place,
        addresses: Collection[str],
        topic: str = "",
        counting: bool = False,
    ) -> None:
        self.domain, self.topic = domain, f"rt{topic}"
        self.peers: dict[bytes, Peer] = {}
        self.writers: dict[bytes, Endpoint] = {}
        self.readers: dict[bytes, Endpoint] = {}
        """The robot's publishers and subscribers."""
        self.strangers: dict[bytes, str] = {}
        """Participants of the domain that are not the robot's: their addresses."""
        self.messages: deque[Message] = deque()
        self.incomplete = 0
        """The size of the latest message that lacked fragments, in bytes."""
        self._prefix, self._place, self._addresses = prefix, place, frozenset(addresses)
        self._counting = counting
        self._followed = {self.topic} if topic else set()
        self._subscribed: dict[
            str, str
        ] = {}  # topics with their types; the place is the number of the subscription
        self._received: dict[bytes, Received] = {}
        self._fragments: dict[tuple[bytes, int], Pieces] = {}
        self._count = 0

    def follow(self, topics: Iterable[str]) -> Answers:
        """Listen to more topics, which are DDS names. Gives the datagrams that say so."""
        self._followed |= set(topics)
        for found in list(self.writers.values()):
            self._subscribe(found)
        for peer in self.peers.values():
            yield from self._ask(peer)

    def _subscribe(self, publisher: Endpoint) -> None:
        topic = publisher.topic
        if topic in self._followed and topic not in self._subscribed and len(self._subscribed) < MOST_TOPICS:
            self._subscribed[topic] = publisher.type
            for peer in self.peers.values():
                peer.knows_us = False

    def announcement(self) -> bytes:
        """Return the datagram that makes the listener known."""
        return rtps.announcement(self._prefix, domain=self.domain, place=self._place)

    def publishers(self, topic: str = "") -> list[Endpoint]:
        """Return the publishers of a topic (a DDS name), or else of the one that was asked for."""
        return [writer for writer in self.writers.values() if writer.topic == (topic or self.topic)]

    def unmatched(self, topic: str = "") -> tuple[str, ...]:
        """Return a sentence for each subscriber of the robot that no publisher of a topic sends anything to."""
        publishers = self.publishers(topic)
        found = []
        for reader in self.readers.values() if publishers else ():
            if reader.topic == (topic or self.topic):
                reasons = [_reasons(one, reader) for one in publishers]
                found += [] if () in reasons else [" and ".join(reasons[0])]
        return tuple(dict.fromkeys(found))

    def receive(self, datagram: bytes, *, source: str, multicast: bool, now: float) -> Answers:
        """Take in a datagram, and give the datagrams that answer it, with their places."""
        packet = rtps.read(datagram)
        if packet is None or packet.prefix == self._prefix:
            return
        yield from self._receive(packet, source=source, multicast=multicast, now=now)

    def _receive(self, packet: Packet, *, source: str, multicast: bool, now: float) -> Answers:
        if peer := self.peers.get(packet.prefix):
            peer.seen = now
        for part in packet.parts:
            match part:
                case rtps.Data(writer=rtps.ANNOUNCER):
                    yield from self._announced(part, packet.prefix, source, multicast=multicast, now=now)
                case rtps.Data(writer=rtps.PUBLICATIONS | rtps.SUBSCRIPTIONS) if peer:
                    yield from self._discovered(part, peer)
                case rtps.Data() | rtps.Fragment() if publisher := self._wanted(packet.prefix + part.writer):
                    self._arrived(publisher, part)
                case rtps.Heartbeat() if peer:
                    yield from self._heartbeat(part, peer)
                case rtps.Gap() if peer:
                    self._gap(part, peer)
                case rtps.Acknack(writer=rtps.SUBSCRIPTIONS) if peer and self._subscribed:
                    peer.knows_us |= part.base > len(self._subscribed)
                case _:
                    pass

    def repeat(self, *, now: float) -> Answers:
        """Give the datagrams that are sent again until they are answered, and forget peers that fell silent."""
        for prefix in [prefix for prefix, peer in self.peers.items() if now - peer.seen > peer.about.lease]:
            self._forget(prefix)
        for peer in list(self.peers.values()):
            if not peer.knows_us:
                yield from self._ask(peer)

    def leave(self) -> Answers:
        """Give the datagrams that say that the listener has left."""
        for peer in self.peers.values():
            for place in self._places(peer.about.meta, peer):
                yield rtps.farewell(self._prefix), place

    def _wanted(self, guid: bytes) -> Endpoint | None:
        found = self.writers.get(guid)
        return found if found and found.topic in self._subscribed else None

    def _announced(self, data: Data, prefix: bytes, source: str, *, multicast: bool, now: float) -> Answers:
        if data.gone:
            self._forget(data.gone[:12])
            return
        about = discovery.participant(data.payload, prefix=prefix)
        if about.prefix != prefix or about.domain not in (None, self.domain):
            return
        if not self._addresses & {source, *(address for address, _ in (*about.meta, *about.data))}:
            if len(self.strangers) < MOST_STRANGERS:
                self.strangers[prefix] = source
            return
        peer = self.peers.get(prefix)
        if peer is None and len(self.peers) < MOST_PEERS:
            peer = self.peers[prefix] = Peer(about=about, source=source, seen=now)
            yield from self._ask(peer)
        if peer:
            peer.about, peer.source = about, source
            peer.by_multicast |= multicast

    def _forget(self, prefix: bytes) -> None:
        self.peers.pop(prefix, None)
        for guid in [guid for guid in (*self.writers, *self.readers) if guid[:12] == prefix]:
            self._end(guid)

    def _end(self, guid: bytes) -> None:
        self.writers.pop(guid, None)
        self.readers.pop(guid, None)
        self._received.pop(guid, None)
        for key in [key for key in self._fragments if key[0] == guid]:
            del self._fragments[key]

    def _discovered(self, data: Data, peer: Peer) -> Answers:
        """Note a publisher or subscriber that a peer has, or that has ended."""
        publishes = data.writer == rtps.PUBLICATIONS
        if not (peer.publications if publishes else peer.subscriptions).add(data.number):
            return
        if data.gone:
            if data.gone[:12] == peer.about.prefix:
                self._end(data.gone)
            return
        found = discovery.endpoint(data.payload, publishes=publishes)
        there = self.writers if publishes else self.readers
        if not found or found.guid[:12] != peer.about.prefix or len(there) >= MOST_ENDPOINTS:
            return
        there[found.guid] = found
        if publishes:
            self._subscribe(found)
            if found.topic in self._subscribed:
                yield from self._ask(peer)

    def _heartbeat(self, part: Heartbeat, peer: Peer) -> Answers:
        """Answer which samples are missing: a writer sends them only to those who ask."""
        publisher = self._wanted(peer.about.prefix + part.writer)
        if part.writer == rtps.PUBLICATIONS:
            received, reader, places = peer.publications, rtps.PUBLICATIONS_READER, peer.about.meta
        elif part.writer == rtps.SUBSCRIPTIONS:
            received, reader, places = peer.subscriptions, rtps.SUBSCRIPTIONS_READER, peer.about.meta
        elif publisher and self._durable(publisher.topic):
            received = self._received.setdefault(publisher.guid, Received())
            reader = rtps.reader(self._number(publisher.topic))
            places = peer.about.data or peer.about.meta
        else:
            return
        received.skip_to(part.first)
        base, missing = received.missing(part.last)
        if part.final and not missing:
            return
        self._count += 1
        # Final, because an answer to this answer would be answered again, and so on.
        answer = rtps.acknack(reader, part.writer, base=base, missing=missing, count=self._count, final=True)
        for place in self._places(places, peer):
            yield rtps.to(self._prefix, peer.about.prefix, answer), place

    def _gap(self, part: Gap, peer: Peer) -> None:
        built_in = {rtps.PUBLICATIONS: peer.publications, rtps.SUBSCRIPTIONS: peer.subscriptions}
        received = built_in.get(part.writer) or self._received.get(peer.about.prefix + part.writer)
        if received and part.first <= received.missing(0)[0]:
            received.skip_to(part.base)

    def _ask(self, peer: Peer) -> Answers:
        """Ask a peer for its publishers and subscribers, and tell it the subscriptions whose types are known."""
        self._count += 1
        asked = (
            (rtps.PUBLICATIONS_READER, rtps.PUBLICATIONS, peer.publications),
            (rtps.SUBSCRIPTIONS_READER, rtps.SUBSCRIPTIONS, peer.subscriptions),
        )
        parts = [
            rtps.acknack(
                reader, writer, base=received.missing(0)[0], missing=(), count=self._count, final=False
            )
            for reader, writer, received in asked
        ]
        parts += [self._subscription(topic, kind) for topic, kind in self._subscribed.items()]
        if self._subscribed:
            parts.append(rtps.heartbeat(self._count, last=len(self._subscribed)))
        for place in self._places(peer.about.meta, peer):
            yield rtps.announcement(self._prefix, domain=self.domain, place=self._place), place
            for at in range(0, len(parts), PARTS):
                yield rtps.to(self._prefix, peer.about.prefix, *parts[at : at + PARTS]), place

    def _subscription(self, topic: str, kind: str) -> bytes:
        return rtps.subscription(
            self._prefix,
            number=self._number(topic),
            topic=topic,
            kind=kind,
            durable=self._durable(topic),
            place=self._place,
        )

    def _number(self, topic: str) -> int:
        return list(self._subscribed).index(topic) + 1

    def _durable(self, topic: str) -> bool:
        publishers = self.publishers(topic)
        return not self._counting and bool(publishers) and all(writer.keeps for writer in publishers)

    def _places(self, places: Collection[Place], peer: Peer) -> list[Place]:
        """Return the places where a peer is reached: those at the robot's address, if it names any.

        Others may be addresses that each computer has for itself, such as 172.17.0.1 of Docker.
        """
        near = [place for place in places if place[0] in self._addresses or place[0] == peer.source]
        return near or list(places)

    def _arrived(self, publisher: Endpoint, part: Data | Fragment) -> None:
        if isinstance(part, rtps.Data):
            self._sample(publisher, part.number, part.payload)
        elif not self._counting:
            self._fragment(publisher, part)
        elif part.first == 1:
            self._sample(publisher, part.number, b"")

    def _sample(self, publisher: Endpoint, number: int, payload: bytes) -> None:
        received = self._received.setdefault(publisher.guid, Received())
        if not received.add(number):
            return
        if not self._durable(publisher.topic):
            received.skip_to(number + 1)  # what is lost, or older, does not come any more
        if payload or self._counting:
            message = Message(topic=publisher.topic, type=publisher.type, payload=payload)
            self.messages.append(message)

    def _fragment(self, publisher: Endpoint, part: Fragment) -> None:
        if part.total > LARGEST_MESSAGE:
            self.incomplete = part.total
            return
        key = (publisher.guid, part.number)
        if key not in self._fragments and len(self._fragments) >= UNFINISHED:
            del self._fragments[next(iter(self._fragments))]
        pieces = self._fragments.setdefault(key, Pieces(size=part.size, total=part.total))
        self.incomplete = part.total
        if whole := pieces.add(part):
            del self._fragments[key]
            self.incomplete = 0
            self._sample(publisher, part.number, whole)


def _reasons(publisher: Endpoint, subscriber: Endpoint) -> tuple[str, ...]:
    """Return why a publisher of a topic does not send to a subscriber of it; nothing if it does."""
    if publisher.type != subscriber.type:
        return (
            f"its type is {discovery.ros_type(subscriber.type)}, and the publisher has {discovery.ros_type(publisher.type)}",
        )
    return quality.mismatches(offered=publisher.quality, wanted=subscriber.quality)
