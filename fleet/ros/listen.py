"""What do a robot's messages say, heard from the desktop? Or why can nobody hear them?

ROS 1 fails quietly: a topic is listed and no data comes, because a node tells others to call it by a name that means
nothing, or something else, to them. So every step to a message is taken one by one here, and the one that fails is
named, with its cure.
"""

from __future__ import annotations

import contextlib
import time
from difflib import get_close_matches
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from fleet.errors import LinkLost, NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.ros import environment, rosmsg, tcpros

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from fleet.config.inventory import Robot

STEP = 10.0  # seconds for each question to a name server, master or node


def messages(robot: Robot, topic: str, *, timeout: float) -> Iterator[str]:
    """Yield a topic's messages from now on, each as text in the manner of ``rostopic echo``.

    A relative topic name follows the robot's namespace, as its own nodes' would. ``timeout``: seconds of silence after
    which the topic counts as silent. Ends by raising only: `Unreachable`, `NotAsPlanned`, `TimedOut` or `LinkLost`,
    whichever step of listening failed.
    """
    name = tcpros.resolved(topic, robot.ros.namespace or "")
    with contextlib.closing(_stream(robot, name)) as stream:
        try:
            types = rosmsg.parse(stream.type, stream.definition)
            while True:
                yield rosmsg.text(rosmsg.decode(stream.read(timeout), stream.type, types))
        except rosmsg.Undecodable as problem:
            raise NotAsPlanned(f"{name} cannot be read: {problem}") from problem
        except tcpros.Silent as problem:
            raise TimedOut(
                f"{name} was silent for {timeout:g} s; its publisher accepts listeners and sends them nothing",
                cure=f"`fab logs --hosts {robot.name}` shows what the node is doing",
            ) from problem
        except tcpros.GraphError as problem:
            raise LinkLost(
                f"the publisher of {name} hung up", cure="it was stopped or restarted: listen again"
            ) from problem


def _stream(robot: Robot, topic: str) -> tcpros.Stream:
    """Take all steps up to the first message."""
    master, graph = _graph(robot)
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


def _graph(robot: Robot) -> tuple[str, tcpros.Graph]:
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
    """See, before connecting, where a node's name leads from here; return where the robot itself is.

    A loopback address would lead to this computer, where another ROS program may well answer.
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
    """What a host name means here; nothing where it does not resolve."""
    try:
        return tuple(str(row[4][0]) for row in tcpros.addresses(host, 0, _soon()))
    except tcpros.NameUnknown:
        return ()


def _link_local(host: str) -> str:
    return " (.local names need mDNS: libnss-mdns on this computer)" if host.endswith(".local") else ""


def _soon() -> float:
    return time.monotonic() + STEP


def nameless_master(robot: Robot) -> RobotError:
    """No name of the master resolves here."""
    names = " nor ".join(dict.fromkeys(urlsplit(uri).hostname or uri for uri in environment.masters(robot)))
    key = "ros.hostname or ros.ip" if environment.has_own_master(robot) else "ros.master"
    return Unreachable(
        f"the ROS master cannot be found: {names} does not resolve on this computer{_link_local(names)}",
        cure=f"set {key} of {robot.name} to a name or IP address that other computers reach (a name that only "
        "~/.ssh/config knows does for SSH, not for ROS)",
    )


def no_master(problem: tcpros.GraphError, *, robot: Robot, master: str) -> RobotError:
    """The master's name resolves, and asking it fails."""
    own = environment.has_own_master(robot)
    status = f"`fab status --hosts {robot.name}` shows whether its containers run"
    cure = status if own else f"ros.master of {robot.name} names it: is it started, and reachable from here?"
    if isinstance(problem, tcpros.NoConnection):
        host, _ = tcpros.address_of(master)
        if own and environment.is_loopback(_called(robot)) and not environment.is_loopback(host):
            return NotAsPlanned(
                f"the ROS nodes of {robot.name} call themselves {_called(robot)}, and so listen to {robot.name} only",
                cure=_rename(robot, next(iter(_ips(host)), "")),
            )
        if problem.refused:
            return Unreachable(f"no ROS master listens at {master}", cure=cure)
        return Unreachable(
            f"the ROS master at {master} is out of reach ({problem.reason})",
            cure="is the robot on, in a network that this computer reaches, and no firewall between?",
        )
    if isinstance(problem, tcpros.Silent):
        return TimedOut(f"the ROS master at {master} accepts connections and answers nothing", cure=cure)
    return NotAsPlanned(f"what answers at {master} is no ROS master that works: {problem}", cure=cure)


def unpublished(topic: str, graph: tcpros.Graph, *, robot: Robot) -> RobotError:
    """The master knows nobody who publishes the topic: is the name wrong, or is nobody there?"""
    logs = f"`fab logs --hosts {robot.name}` shows what its nodes are doing"
    listeners = graph.subscribers.get(topic)
    if listeners:
        return NotAsPlanned(f"nobody publishes {topic}, though {listeners[0]} listens to it", cure=logs)
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
    """Choose, among a topic's publishers, the robot's own node.

    With its own master they are all its own, and one with its own name is best. On a shared master the others are
    other robots'. Raises `NotAsPlanned` where only those publish.
    """
    called = _called(robot)
    own = [node for node, uri in uris.items() if urlsplit(uri).hostname == called.lower()]
    if own:
        return own[0]
    if environment.has_own_master(robot):
        return next(iter(uris))
    others = ", ".join(f"{node} at {urlsplit(uri).hostname}" for node, uri in list(uris.items())[:3])
    raise NotAsPlanned(
        f"{topic} is published by {others}, and not by {robot.name}, whose nodes call themselves {called}",
        cure=f"`fab restart --hosts {robot.name}`: after a restart of a shared master, nodes do not register again",
    )


def no_node(
    problem: tcpros.GraphError, *, robot: Robot, node: str, host: str, home: Collection[str]
) -> RobotError:
    """A node's name resolves, and talking to it fails."""
    restart = f"`fab restart --hosts {robot.name}`"
    if isinstance(problem, tcpros.NoConnection):
        meaning = _ips(host)
        if home and not set(home) & set(meaning):
            means = "" if host in meaning else f" ({', '.join(meaning)} here)"
            return misnamed(f"which{means} is not where {robot.name} is", robot, node, host, home)
        if problem.refused:
            return Unreachable(
                f"node {node} is registered and gone: {problem}", cure=f"it died without a word; {restart}"
            )
        return Unreachable(
            f"node {node} is out of reach: {problem}",
            cure="a firewall? ROS nodes listen on any port above 1023, all of which must be open to this computer",
        )
    if isinstance(problem, tcpros.Silent):
        return TimedOut(f"node {node} accepts connections and answers nothing: {problem}", cure=restart)
    return NotAsPlanned(f"node {node} gives no data: {problem}", cure=restart)


def misnamed(meaning: str, robot: Robot, node: str, host: str, home: Collection[str]) -> RobotError:
    """A node tells others to call it by a name that leads them elsewhere."""
    called = _called(robot)
    if called.lower() != host.lower():
        cure = f"the inventory says {called}: `fab ship --hosts {robot.name}`"
    else:
        better = next((ip for ip in home if not environment.is_loopback(ip) and ip != host), "")
        cure = _rename(robot, better)
    return NotAsPlanned(f"node {node} tells others to call it {host}, {meaning}", cure=cure)


def _rename(robot: Robot, address: str) -> str:
    return (
        f"set ros.ip of {robot.name} to {address or 'an IP address that other computers reach'}, and ship it"
    )


def _called(robot: Robot) -> str:
    """What the robot's nodes were told to call themselves."""
    variables = environment.environment(robot)
    return variables.get("ROS_HOSTNAME") or variables["ROS_IP"]
