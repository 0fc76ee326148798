"""Which messages does a robot publish, as received on the desktop? If none arrive, why not?

ROS 1 fails silently: a topic is listed but no data arrives, because a node registers with a name that does not resolve
elsewhere, or that leads to another computer. So each step on the way to a message is taken separately here; the step that
fails is named, with its cure.
"""

from __future__ import annotations

import contextlib
import time
from difflib import get_close_matches
from functools import partial
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from fleet.errors import LinkLost, NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.ros import environment, rosmsg, tcpros
from fleet.ros.message import Message

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterator, Mapping

    from fleet.config.inventory import Robot

STEP = 10.0  # seconds for each request to a name server, master or node
AGAIN = 0.5  # seconds until a publisher that went away is looked for again


def messages(robot: Robot, topic: str, *, timeout: float) -> Generator[Message]:
    """Yield a topic's messages from now on.

    A relative topic name is resolved in the robot's namespace, as for its own nodes. ``timeout``: seconds without a
    message after which the topic counts as silent. A publisher that goes away, as in a restart or a ship, has as long to
    come back. The iterator ends only by raising `Unreachable`, `NotAsPlanned`, `TimedOut` or `LinkLost`, depending on the
    step that failed.
    """
    name = tcpros.resolved(topic, robot.ros.namespace or "")
    lost = None  # when the publisher went away
    while True:
        try:
            for message in _from_one_publisher(robot, name, timeout=timeout):
                lost = None
                yield message
        except LinkLost:
            lost = lost or time.monotonic()
            if time.monotonic() - lost > timeout:
                raise
        except RobotError:
            if lost is None or time.monotonic() - lost > timeout:
                raise
        time.sleep(AGAIN)


def _from_one_publisher(robot: Robot, name: str, *, timeout: float) -> Iterator[Message]:
    """Yield messages until the publisher goes away: then `LinkLost` is raised."""
    with contextlib.closing(stream_of(robot, name)) as stream:
        read = reader(name, stream.type, stream.definition)
        try:
            while True:
                data = stream.read(timeout)
                now = {"at": time.time(), "monotonic": time.monotonic()}
                yield Message(**now, size=len(data), read=partial(read, data))
        except tcpros.Silent as problem:
            raise TimedOut(
                f"{name} was silent for {timeout:g} s: its publisher took the subscription and sent nothing in that time",
                cure=f"`fab logs --hosts {robot.name}` shows what the node does; a slower topic needs a longer --timeout",
            ) from problem
        except tcpros.GraphError as problem:
            raise LinkLost(
                f"the publisher of {name} closed the connection",
                cure=f"`fab status --hosts {robot.name}` shows whether its containers run",
            ) from problem


def reader(topic: str, kind: str, definition: str) -> Callable[[bytes], Mapping[str, rosmsg.Value]]:
    """Return what reads the bytes of a topic's messages. It raises `NotAsPlanned` if the type cannot be read."""
    types: dict[str, Mapping[str, tuple[rosmsg.Field, ...]]] = {}

    def read(data: bytes) -> Mapping[str, rosmsg.Value]:
        try:
            if kind not in types:
                types[kind] = rosmsg.parse(kind, definition)
            return rosmsg.decode(data, kind, types[kind])
        except rosmsg.Undecodable as problem:
            raise NotAsPlanned(f"{topic} cannot be read: {problem}") from problem

    return read


def stream_of(robot: Robot, topic: str) -> tcpros.Stream:
    """Return the bytes of a topic: take all steps up to the first message. Raises `RobotError`."""
    master, graph = master_graph(robot)
    if not graph.publishers.get(topic):
        raise unpublished(topic, graph, robot=robot)
    try:
        uris = {
            node: tcpros.node_uri(master, node, deadline=_soon()) for node in sorted(graph.publishers[topic])
        }
    except tcpros.GraphError as problem:
        raise no_master(problem, robot=robot, master=master) from problem
    node = own_node(uris, topic, robot=robot)
    host, port = _ask(robot, node, uris[node], topic)
    home = _check(robot, node, host)
    try:
        return tcpros.Stream(host, port, topic, deadline=_soon())
    except tcpros.GraphError as problem:
        raise no_node(problem, robot=robot, node=node, host=host, home=home) from problem


def master_graph(robot: Robot) -> tuple[str, tcpros.Graph]:
    """Ask the master, by the first of its names that resolves here."""
    for master in environment.masters(robot):
        try:
            return master, tcpros.graph(master, deadline=_soon())
        except tcpros.NameUnknown:
            continue
        except tcpros.GraphError as problem:
            raise no_master(problem, robot=robot, master=master) from problem
    raise nameless_master(robot)


def _ask(robot: Robot, node: str, uri: str, topic: str) -> tuple[str, int]:
    """Ask a node where the topic's data comes out."""
    try:
        host, _ = tcpros.address_of(uri)
    except tcpros.GraphError as problem:
        raise NotAsPlanned(f"node {node} registered as {problem}") from problem
    home = _check(robot, node, host)
    try:
        return tcpros.data_address(uri, topic, deadline=_soon())
    except tcpros.GraphError as problem:
        raise no_node(problem, robot=robot, node=node, host=host, home=home) from problem


def _check(robot: Robot, node: str, host: str) -> tuple[str, ...]:
    """Check, before connecting, where a node's name leads from here. Returns the robot's own IP addresses.

    A loopback address would lead to this computer, where another ROS program may answer.
    """
    home = next(filter(None, map(_ips, environment.own_names(robot))), ())
    meaning = _ips(host)
    if not meaning:
        raise misnamed(f"a name that does not resolve here{_link_local(host)}", robot, node, host, home)
    if any(map(environment.is_loopback, meaning)) and not any(map(environment.is_loopback, home)):
        means = "" if host in meaning else f" ({meaning[0]} here)"
        raise misnamed(f"which{means} is this computer itself, seen from here", robot, node, host, home)
    return home


def _ips(host: str) -> tuple[str, ...]:
    """Resolve a host name on this computer; nothing if it does not resolve."""
    try:
        return tuple(str(row[4][0]) for row in tcpros.addresses(host, 0, _soon()))
    except tcpros.NameUnknown:
        return ()


def _link_local(host: str) -> str:
    return " (.local names need mDNS: libnss-mdns on this computer)" if host.endswith(".local") else ""


def _soon() -> float:
    return time.monotonic() + STEP


def nameless_master(robot: Robot) -> RobotError:
    """Explain that no name of the master resolves here."""
    names = " nor ".join(dict.fromkeys(urlsplit(uri).hostname or uri for uri in environment.masters(robot)))
    key = "ros.hostname or ros.ip" if environment.has_own_master(robot) else "ros.master"
    return Unreachable(
        f"the ROS master cannot be found: {names} does not resolve on this computer{_link_local(names)}",
        cure=f"set {key} of {robot.name} to a name or IP address that other computers can reach (ROS cannot use "
        "names from ~/.ssh/config)",
    )


def no_master(problem: tcpros.GraphError, *, robot: Robot, master: str) -> RobotError:
    """Explain why a master whose name resolves cannot be asked."""
    own = environment.has_own_master(robot)
    status = f"`fab status --hosts {robot.name}` shows whether its containers run"
    cure = (
        status
        if own
        else f"check that it runs, and that this computer can reach it (ros.master of {robot.name} names it)"
    )
    if isinstance(problem, tcpros.NoConnection):
        host, _ = tcpros.address_of(master)
        if own and environment.is_loopback(_called(robot)) and not environment.is_loopback(host):
            return NotAsPlanned(
                f"the ROS nodes of {robot.name} call themselves {_called(robot)}, so only {robot.name} itself can reach them",
                cure=_rename(robot, next(iter(_ips(host)), "")),
            )
        if problem.refused:
            return Unreachable(f"no ROS master listens at {master}", cure=cure)
        return Unreachable(
            f"the ROS master at {master} cannot be reached ({problem.reason})",
            cure="check that the robot is on, that this computer can reach its network, and that no firewall is between",
        )
    if isinstance(problem, tcpros.Silent):
        return TimedOut(f"the ROS master at {master} accepts connections but does not answer", cure=cure)
    return NotAsPlanned(f"the program at {master} is not a working ROS master: {problem}", cure=cure)


def unpublished(topic: str, graph: tcpros.Graph, *, robot: Robot) -> RobotError:
    """Explain why a topic has no publisher: its name is wrong, or its node does not run."""
    logs = f"`fab logs --hosts {robot.name}` shows what its nodes do"
    listeners = graph.subscribers.get(topic)
    if listeners:
        return NotAsPlanned(f"no node publishes {topic}, although {listeners[0]} subscribes to it", cure=logs)
    published = sorted(graph.publishers)
    last = topic.rpartition("/")[2]
    near = [name for name in published if name.rpartition("/")[2] == last]
    near = near or get_close_matches(topic, published, n=3)
    if near:
        return NotAsPlanned(f"there is no topic {topic}", cure=f"did you mean {' or '.join(near[:3])}?")
    known = ", ".join(published[:8]) + (", ..." if len(published) > 8 else "")
    cure = f"published are {known}" if published else logs
    return NotAsPlanned(f"there is no topic {topic}", cure=cure)


def own_node(uris: Mapping[str, str], topic: str, *, robot: Robot) -> str:
    """Choose the robot's own node among a topic's publishers.

    With its own master, all are its own; a node with the robot's name is preferred. On a shared master, the others belong
    to other robots. Raises `NotAsPlanned` if only those publish.
    """
    called = _called(robot)
    own = [node for node, uri in uris.items() if urlsplit(uri).hostname == called.lower()]
    if own:
        return own[0]
    if environment.has_own_master(robot):
        return next(iter(uris))
    others = ", ".join(f"{node} at {urlsplit(uri).hostname}" for node, uri in list(uris.items())[:3])
    raise NotAsPlanned(
        f"{topic} is published by {others}, not by {robot.name}, whose nodes call themselves {called}",
        cure=f"`fab restart --hosts {robot.name}`: nodes do not register again after a restart of a shared master",
    )


def no_node(
    problem: tcpros.GraphError, *, robot: Robot, node: str, host: str, home: Collection[str]
) -> RobotError:
    """Explain why a node whose name resolves sends no data."""
    restart = f"`fab restart --hosts {robot.name}`"
    if isinstance(problem, tcpros.NoConnection):
        meaning = _ips(host)
        if home and not set(home) & set(meaning):
            means = "" if host in meaning else f" ({', '.join(meaning)} here)"
            return misnamed(f"which{means} is not where {robot.name} is", robot, node, host, home)
        if problem.refused:
            return Unreachable(
                f"node {node} is registered but does not run: {problem}",
                cure=f"it ended without unregistering; {restart}",
            )
        return Unreachable(
            f"node {node} cannot be reached: {problem}",
            cure="check for a firewall: ROS nodes use any port above 1023, and all of them must be open to this computer",
        )
    if isinstance(problem, tcpros.Silent):
        return TimedOut(f"node {node} accepts connections but does not answer: {problem}", cure=restart)
    return NotAsPlanned(f"node {node} sends no data: {problem}", cure=restart)


def misnamed(meaning: str, robot: Robot, node: str, host: str, home: Collection[str]) -> RobotError:
    """Explain that a node registered with a name that leads elsewhere."""
    called = _called(robot)
    if called.lower() != host.lower():
        cure = f"the inventory says {called}: run `fab ship --hosts {robot.name}`"
    else:
        better = next((ip for ip in home if not environment.is_loopback(ip) and ip != host), "")
        cure = _rename(robot, better)
    return NotAsPlanned(f"node {node} registered as {host}, {meaning}", cure=cure)


def _rename(robot: Robot, address: str) -> str:
    return f"set ros.ip of {robot.name} to {address or 'an IP address that other computers can reach'}, then run `fab ship`"


def _called(robot: Robot) -> str:
    """Return the name that the robot's nodes register with."""
    variables = environment.environment(robot)
    return variables.get("ROS_HOSTNAME") or variables["ROS_IP"]
