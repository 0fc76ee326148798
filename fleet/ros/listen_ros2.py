"""Which messages does a ROS 2 robot publish, as received on a desktop without ROS? If none arrive, why not?

The desktop joins the robot's domain as `fleet.ros.rtps_graph` does, and finds the robot by multicast and by its address,
so that messages arrive also where multicast does not. The robot itself is asked for the definition of the type, and, if
no message arrives, how its programs use its network.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import sys
import time
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Self

from fleet import onboard
from fleet.errors import NotAsPlanned, Unreachable
from fleet.ros import cdr, environment, rosmsg, rtps, silence, tcpros
from fleet.ros.message import Message
from fleet.ros.rtps_graph import Graph

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping

    from fleet.config.inventory import Robot
    from fleet.ros import rtps_graph
    from fleet.ros.rtps_discovery import Place

    OnRobot = Callable[[tuple[str, ...]], str]
    """Runs a command on the robot and returns its output. Raises `RobotError`."""

RESOLVE = 10.0
"""Seconds to resolve the robot's address."""

REPEAT = 0.5
"""Seconds between two announcements until the first message. Later ones only keep the participant alive."""

KEEP_ALIVE = 3.0
"""Seconds, as for Fast DDS: others forget a participant that is silent for its lease of 20 s."""

MOST_NOTES = 20
"""Subscribers that are told of."""

ROOM = 32 << 20
"""Bytes of received datagrams that the system shall keep for a message: a camera image arrives in one burst."""

HEARD_BY_NOW = 10.0
"""Seconds: Fast DDS announces itself by multicast every 3 s. Other middlewares may take longer, so they are not judged."""

SETTLED = 2.0
"""Seconds without a new publisher or subscriber after which all are known: participants announce themselves several times then."""

_FORCE_ROOM = 33  # SO_RCVBUFFORCE of Linux, which `socket` does not name
_STAMPS = 35  # SO_TIMESTAMPNS of Linux, the same: each datagram comes with the time when it arrived
_TIME = struct.Struct("@ll")  # seconds and nanoseconds


class Arrival(NamedTuple):
    """A message, and when it arrived: see `fleet.ros.message.Message`."""

    at: float
    monotonic: float
    message: rtps_graph.Message


def messages(
    robot: Robot,
    topic: str,
    *,
    timeout: float,
    on_robot: OnRobot,
    on_note: Callable[[str], None] = lambda _: None,
) -> Generator[Message]:
    """Yield a topic's messages from now on.

    A relative topic name is resolved in the robot's namespace. ``timeout``: seconds without a message after which the
    topic counts as silent; a publisher that is restarted has as long to come back. ``on_note`` gets a sentence if messages
    arrive here, and others would not get them. The iterator ends only by raising `RobotError`.
    """
    if robot.ros.rmw == "rmw_zenoh_cpp":
        raise silence.by_zenoh(robot)
    name = tcpros.resolved(topic, robot.ros.namespace or "")
    with Listener(robot, name, addresses_of(robot, on_robot)) as listener:
        read = Types(name, on_robot).read
        heard, last = 0, time.monotonic()
        while time.monotonic() - last < timeout:
            listener.announce(every=KEEP_ALIVE if heard else REPEAT)
            for at, monotonic, message in listener.receive():
                heard, last = heard + 1, time.monotonic()
                yield Message(
                    at=at,
                    monotonic=monotonic,
                    size=len(message.payload),
                    read=partial(read, message.type, message.payload),
                )
                last = time.monotonic()  # whoever reads them may have taken a while
            for note in listener.notes() if heard else ():
                on_note(note)
        raise silence.reason(robot, listener.graph, network_of(on_robot), heard=heard, timeout=timeout)


def network_of(on_robot: OnRobot) -> silence.Network:
    """Ask the robot how its programs use its network."""
    return silence.read(on_robot(("sh", "-c", onboard.text("ros2_network.sh"))))


def addresses_of(robot: Robot, on_robot: OnRobot) -> tuple[str, ...]:
    """Return the robot's IPv4 addresses: those of its name, or else the one that SSH reached."""
    with contextlib.suppress(tcpros.NameUnknown):
        rows = tcpros.addresses(robot.address, 0, time.monotonic() + RESOLVE)
        if found := [str(row[4][0]) for row in rows if row[0] == socket.AF_INET]:
            return tuple(dict.fromkeys(found))
    address = network_of(on_robot).address
    if address and ":" not in address:
        return (address,)
    raise Unreachable(
        f"{robot.address} has no IPv4 address that this computer knows, and DDS needs one",
        cure=f"set the address of {robot.name} to an IPv4 address, or to a name that resolves to one",
    )


class Types:
    """The definitions of the types of a topic's messages. The robot is asked once for each."""

    def __init__(self, topic: str, on_robot: OnRobot) -> None:
        self._topic, self._on_robot = topic, on_robot
        self._known: dict[str, cdr.Types] = {}

    def read(self, kind: str, payload: bytes) -> Mapping[str, rosmsg.Value]:
        """Return the values of a message. ``kind`` is a type of DDS. Raises `NotAsPlanned`."""
        try:
            name = cdr.type_name(kind)
            if name not in self._known:
                self._known[name] = cdr.parse(name, _definitions(name, self._on_robot))
            return cdr.decode(payload, name, self._known[name])
        except rosmsg.Undecodable as problem:
            raise NotAsPlanned(f"{self._topic} cannot be read: {problem}") from problem


def _definitions(name: str, on_robot: OnRobot) -> str:
    """Ask the robot's containers, one after the other, for the definition of a type; "" if none has it."""
    each = 'for c in $(docker ps -q); do t=$(docker exec "$c" sh -c "$1" types "$2" 2>/dev/null) && echo "$t" && exit; done'
    return on_robot(("sh", "-c", f"{each}; exit 0", "types", onboard.text("ros2_types.sh"), name))


class Listener:
    """The sockets of a listener, and what it has heard. Close it, or use it with ``with``: it then says goodbye."""

    def __init__(
        self, robot: Robot, topic: str, addresses: tuple[str, ...], *, counting: bool = False
    ) -> None:
        self._robot = robot
        self._domain = environment.domain(robot)
        self._targets = addresses
        address = _own_address(addresses[0])
        self._open = contextlib.ExitStack()
        self._own = self._socket()
        self._own.bind(("", 0))
        place = (address, self._own.getsockname()[1])
        self._own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(place[0]))
        self._multicast = self._join(place[0])
        self._announced = 0.0
        self._began = self._changed = time.monotonic()
        self._known = 0
        self._judged = False
        self._noted: set[str] = set()
        self.graph = Graph(
            prefix=b"\1\x42" + os.urandom(10),
            domain=self._domain,
            place=place,
            addresses=addresses,
            topic=topic,
            counting=counting,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._send(self.graph.leave())
        self._open.close()

    def announce(self, *, every: float) -> None:
        """Announce the listener, and repeat what was not answered, if the last time is ``every`` seconds ago."""
        now = time.monotonic()
        if now - self._announced < every:
            return
        self._announced = now
        said = self.graph.announcement()
        places = [(rtps.GROUP, rtps.port(self._domain, 0))]
        for address in self._targets:
            places += [
                (address, rtps.port(self._domain, 10 + 2 * number)) for number in range(rtps.PARTICIPANTS)
            ]
        self._send((said, place) for place in places)
        self._send(self.graph.repeat(now=now))

    def follow(self, topics: Iterable[str]) -> None:
        """Listen to more topics, which are DDS names."""
        self._send(self.graph.follow(topics))

    def receive(self) -> Generator[Arrival]:
        """Wait for a moment, take in what arrives, and yield the messages of the topics."""
        sockets = [self._own, *([self._multicast] if self._multicast else [])]
        for ready in select.select(sockets, (), (), 0.1)[0]:
            try:
                datagram, source, at = _received(ready)
            except OSError:
                continue
            now = time.monotonic()
            self._send(
                self.graph.receive(datagram, source=source, multicast=ready is self._multicast, now=now)
            )
            known = len(self.graph.writers) + len(self.graph.readers)
            if known != self._known:
                self._known, self._changed = known, now
            # A clock that is set between the two looks at it cannot make a message younger than now.
            monotonic = now - max(0.0, time.time() - at)
            while self.graph.messages:
                yield Arrival(at, monotonic, self.graph.messages.popleft())

    @property
    def settled(self) -> bool:
        """Whether publishers or subscribers were found, and no new ones for a while."""
        return bool(self._known) and time.monotonic() - self._changed > SETTLED

    def notes(self) -> Iterator[str]:
        """Yield, each once, why others do not get the messages that arrive here."""
        topic = self.graph.topic.removeprefix("rt")
        for reason in self.graph.unmatched() if self.settled else ():
            yield from self._once(unmatched(topic, self._robot.name, reason))
        peers = self.graph.peers.values()
        late = time.monotonic() - self._began > HEARD_BY_NOW
        fast = peers and all(peer.about.vendor == "Fast DDS" for peer in peers)
        if self._judged or not late or not self._multicast or not fast:
            return
        self._judged = True
        if not any(peer.by_multicast for peer in peers):
            yield (
                f"messages arrive, but the multicast of {self._robot.name} does not: other computers with ROS 2 may not "
                "find its nodes (`ros.peers` names them to each other; ros.discovery must be subnet)"
            )

    def _once(self, note: str) -> Iterator[str]:
        if note not in self._noted and len(self._noted) < MOST_NOTES:
            self._noted.add(note)
            yield note

    def _send(self, datagrams: Iterable[tuple[bytes, Place]]) -> None:
        for datagram, place in datagrams:
            with contextlib.suppress(
                OSError
            ):  # a network that is away, now or for good: nothing will be heard then
                self._own.sendto(datagram, place)

    def _socket(self) -> socket.socket:
        opened = self._open.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        with contextlib.suppress(
            OSError
        ):  # Linux gives as much as net.core.rmem_max allows, macOS all or nothing
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        if sys.platform == "linux":
            with contextlib.suppress(OSError):
                opened.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
                opened.setsockopt(socket.SOL_SOCKET, _FORCE_ROOM, ROOM)  # root may have it all
        return opened

    def _join(self, address: str) -> socket.socket | None:
        """Open a socket for the multicast of the domain; None if this computer cannot."""
        opened = self._socket()
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            # Bound to the group's address: only its multicast arrives, not what others send to this computer's ROS.
            opened.bind((rtps.GROUP, rtps.port(self._domain, 0)))
            membership = socket.inet_aton(rtps.GROUP) + socket.inet_aton(address)
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError:
            return None
        return opened


def unmatched(topic: str, robot: str, reason: str) -> str:
    """Return a sentence about a subscriber that no publisher of a topic sends to."""
    return f"a subscriber of {topic} on {robot} matches no publisher: {reason}"


def _received(opened: socket.socket) -> tuple[bytes, str, float]:
    """Return a datagram, its sender, and when it arrived: it may have waited, for example while a type was asked for."""
    datagram, stamps, _, (source, _) = opened.recvmsg(65536, socket.CMSG_SPACE(_TIME.size))
    for level, kind, raw in stamps:
        if (level, kind, len(raw)) == (socket.SOL_SOCKET, _STAMPS, _TIME.size):
            seconds, nanoseconds = _TIME.unpack(raw)
            return datagram, source, seconds + nanoseconds / 1e9
    return datagram, source, time.time()


def _own_address(robot: str) -> str:
    """Return this computer's address in the network of the robot."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((robot, rtps.port(0, 0)))  # sends nothing; asks the routing table
        except OSError as problem:
            raise Unreachable(
                f"this computer has no route to {robot} ({problem.strerror})",
                cure="check its network; `fab listen --via robot` listens in a container of the robot, over SSH",
            ) from problem
        return str(probe.getsockname()[0])
