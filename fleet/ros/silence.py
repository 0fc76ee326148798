"""Why does no message of a ROS 2 topic arrive?

ROS 2 fails silently, too: nodes of two domains, a network without multicast, or a container with a network of its own
just do not find each other. `reason` compares what a listener has heard with how the robot's programs use its network,
and names the cause with its cure. `read` reads what `onboard/ros2_network.sh` prints.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import TYPE_CHECKING

from fleet.errors import NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.ros import environment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.inventory import Robot
    from fleet.ros.rtps_graph import Graph

DOMAINS = range(233)
_GROUP = "0100FFEF"  # 239.255.0.1, as Linux writes it on the processors that robots have
_VIA = "`fab listen --via robot` listens in a container of the robot, over SSH"
_LOCAL_ONLY = {"LOCALHOST", "OFF"}


@dataclass(frozen=True, kw_only=True)
class Container:
    """A running container: ``network`` is Docker's name of its mode, ``settings`` are its variables about ROS."""

    name: str
    network: str
    settings: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Network:
    """How a robot's programs use its network.

    ``address`` is where SSH reached it. ``domains``: for each domain that DDS programs of the robot's own network are in,
    the offsets of their ports. ``interfaces``: those on which a program hears the multicast of discovery.
    """

    address: str = ""
    domains: Mapping[int, frozenset[int]] = field(default_factory=dict)
    interfaces: frozenset[str] = frozenset()
    containers: tuple[Container, ...] = ()


def read(text: str) -> Network:
    """Return what `ros2_network.sh` says; lines that make no sense are left out."""
    sections = dict(re.findall(r"^== (\w+)\n(.*?)(?=^== )", text, flags=re.MULTILINE | re.DOTALL))
    login = sections.get("ssh", "").split()
    return Network(
        address=login[2] if len(login) == 4 else "",
        domains=_domains(sections.get("udp", "")),
        interfaces=_interfaces(sections.get("igmp", "")),
        containers=_containers(sections.get("containers", "")),
    )


def _domains(udp: str) -> dict[int, frozenset[int]]:
    """Return the domains of the ports in use.

    Multicast discovery is at offset 0 of a domain; a participant has a pair of ports from offset 10 on. A single port
    proves nothing: the system gives such ports to any program.
    """
    found: dict[int, set[int]] = {}
    for number in re.findall(r"^\s*\d+: [0-9A-F]{8}:([0-9A-F]{4}) ", udp, flags=re.MULTILINE):
        domain, offset = divmod(int(number, 16) - 7400, 250)
        if domain in DOMAINS and (offset == 0 or 10 <= offset < 130):
            found.setdefault(domain, set()).add(offset)
    return {
        domain: frozenset(offsets)
        for domain, offsets in sorted(found.items())
        if 0 in offsets or any(offset % 2 == 0 and offset + 1 in offsets for offset in offsets)
    }


def _interfaces(igmp: str) -> frozenset[str]:
    found, name = set(), ""
    for line in igmp.splitlines():
        words = line.split()
        if line[:1].isdigit() and len(words) > 1:
            name = words[1].rstrip(":")
        elif words[:1] == [_GROUP]:
            found.add(name)
    return frozenset(found)


def _containers(text: str) -> tuple[Container, ...]:
    found: list[tuple[str, str, dict[str, str]]] = []
    for line in text.splitlines():
        if line.startswith("/"):
            name, _, network = line[1:].partition(" ")
            found.append((name, network, {}))
        elif found and "=" in line:
            key, _, value = line.strip().partition("=")
            found[-1][2][key] = value
    return tuple(Container(name=name, network=network, settings=said) for name, network, said in found)


def reason(robot: Robot, graph: Graph, network: Network, *, heard: int, timeout: float) -> RobotError:
    """Return why a listener got no message for ``timeout`` seconds, after it has ``heard`` some messages before."""
    topic = graph.topic.removeprefix("rt")
    logs = (
        f"`fab logs --hosts {robot.name}` shows what the node does; a slower topic needs a longer --timeout"
    )
    if not graph.peers:
        return _nobody(robot, graph, network)
    if not graph.writers:
        return _one_way(robot, graph)
    if not graph.publishers():
        return _unpublished(graph, robot, topic)
    if graph.incomplete and not heard:
        return NotAsPlanned(
            f"the messages on {topic} have {graph.incomplete:,} bytes, and parts of each are lost on the way",
            cure="use a wire in place of Wi-Fi, or a compressed topic; on this computer, `sysctl -w net.core.rmem_max=33554432` makes room for large messages",
        )
    if not heard and not any(peer.knows_us for peer in graph.peers.values()):
        return TimedOut(
            f"the publisher of {topic} does not answer the subscription of this computer",
            cure=_firewall(robot, graph.domain),
        )
    return TimedOut(
        f"{topic} was silent for {timeout:g} s: its publisher took the subscription and sent nothing in that time",
        cure=logs,
    )


def _nobody(robot: Robot, graph: Graph, network: Network) -> RobotError:
    """Return why none of the robot's programs answered."""
    name, domain = robot.name, graph.domain
    there = network.domains.get(domain)
    if there is None:
        return _elsewhere(robot, network) if network.domains else _no_program(robot, network)
    settings = [one for one in network.containers if one.network == "host"]
    alone = [one for one in settings if one.settings.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") in _LOCAL_ONLY]
    if alone or 0 not in there:
        said = (
            f"ROS_AUTOMATIC_DISCOVERY_RANGE={alone[0].settings['ROS_AUTOMATIC_DISCOVERY_RANGE']} in {alone[0].name}"
            if alone
            else "ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST or OFF, or ROS_DISCOVERY_SERVER is set"
        )
        return NotAsPlanned(
            f"the nodes of {name} look for nobody on other computers: {said}",
            cure=f"set ros.discovery of {name} to subnet, then run `fab ship`",
        )
    if network.interfaces and not network.interfaces - {"lo"}:
        return NotAsPlanned(
            f"the nodes of {name} are on the loopback interface only, so no other computer hears them",
            cure="remove ROS_LOCALHOST_ONLY from the environment of the stack, then run `fab ship`",
        )
    return Unreachable(
        f"the nodes of {name} are in domain {domain}, as they should be, but do not answer this computer",
        cure=f"if the network does not pass multicast, set ros.peers of {name}; or {_firewall(robot, domain)}",
    )


def _elsewhere(robot: Robot, network: Network) -> RobotError:
    domains = ", ".join(map(str, network.domains))
    real, wanted = next(iter(network.domains)), environment.domain(robot)
    return NotAsPlanned(
        f"the nodes of {robot.name} are in domain {domains}, and the inventory says {wanted}",
        cure=f"set `ros: {{domain: {real}}}`, or name ROS_DOMAIN_ID under `environment:` of the service and run `fab ship`",
    )


def _no_program(robot: Robot, network: Network) -> RobotError:
    if zenoh := [one for one in network.containers if "zenoh" in one.settings.get("RMW_IMPLEMENTATION", "")]:
        return by_zenoh(robot, zenoh[0].name)
    fenced = [
        one
        for one in network.containers
        if one.network != "host" and any(key.startswith(("ROS_", "RMW_")) for key in one.settings)
    ]
    if fenced:
        return NotAsPlanned(
            f"{fenced[0].name} has a network of its own ({fenced[0].network}), which no other computer can look into",
            cure=f"write `network_mode: host` into its service, then run `fab ship`; {_VIA}",
        )
    status = f"`fab status --hosts {robot.name}` shows whether its containers run"
    if not network.containers:
        return NotAsPlanned(f"no container runs on {robot.name}", cure=status)
    return NotAsPlanned(
        f"no program in the network of {robot.name} speaks DDS, as nodes of ROS 2 do", cure=status
    )


def by_zenoh(robot: Robot, container: str = "") -> RobotError:
    """Explain that a robot's middleware is one that `fab listen` does not speak."""
    return NotAsPlanned(
        f"{container or robot.name} uses rmw_zenoh_cpp, and `fab listen` hears only middlewares that speak DDS",
        cure=f"{_VIA}, with the container's own middleware",
    )


def _firewall(robot: Robot, domain: int) -> str:
    first = 7400 + 250 * domain
    return (
        f"check for a firewall on {robot.name} and on this computer: ROS 2 uses UDP, in domain {domain} the ports "
        f"{first} to {first + 249}, and any port for the messages to this computer; without UDP, {_VIA}"
    )


def _one_way(robot: Robot, graph: Graph) -> RobotError:
    """Return why nodes that announce themselves name no topic: each node of ROS 2 has some."""
    if any(peer.about.secured for peer in graph.peers.values()):
        return NotAsPlanned(
            f"the nodes of {robot.name} talk only to those with a key (SROS 2)",
            cure=f"a container has one: {_VIA}",
        )
    return Unreachable(
        f"the nodes of {robot.name} announce themselves, but do not answer this computer",
        cure=_firewall(robot, graph.domain),
    )


def _unpublished(graph: Graph, robot: Robot, topic: str) -> RobotError:
    published = sorted(
        {writer.topic.removeprefix("rt") for writer in graph.writers.values() if writer.topic[:3] == "rt/"}
    )
    last = topic.rpartition("/")[2]
    near = [name for name in published if name.rpartition("/")[2] == last]
    near = near or get_close_matches(topic, published, n=3)
    if near:
        return NotAsPlanned(f"there is no topic {topic}", cure=f"did you mean {' or '.join(near[:3])}?")
    known = ", ".join(published[:8]) + (", ..." if len(published) > 8 else "")
    logs = f"`fab logs --hosts {robot.name}` shows what its nodes do"
    return NotAsPlanned(f"there is no topic {topic}", cure=f"published are {known}" if published else logs)
