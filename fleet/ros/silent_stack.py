"""Will the ROS 2 services of one stack hear each other?

Fast DDS, the usual middleware, takes shared memory for granted between programs of one host. Two containers on the host's
network look like one host, and have a shared memory each: topics are found, and no message ever arrives (Fast-DDS #5396,
#5265, #2956). With one shared memory, root and another user still do not hear each other. Pure: a stack in, sentences out.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from fleet.config.stack import Stack

_ROS_2 = {
    *("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_AUTOMATIC_DISCOVERY_RANGE"),
    *("ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY"),
}
"""Variables that only nodes of ROS 2 read."""

_ROOT = {"0", "root"}


def warnings(stack: Stack, *, version: int) -> tuple[str, ...]:
    """Return a sentence for each reason why services of a stack will not hear each other. ``version`` is the robot's ROS."""
    services = stack.model.get("services") or {}
    nodes = {name: value for name, value in services.items() if _by_shared_memory(value, version=version)}
    apart = _together(
        (one, other)
        for one, other in combinations(nodes, 2)
        if _memory(one, services) != _memory(other, services)
    )
    strangers = _together(
        (one, other)
        for one, other in combinations(nodes, 2)
        if _memory(one, services) == _memory(other, services)
        and _root_beside_another(nodes[one], nodes[other])
    )
    found = []
    if apart:
        found.append(
            f"no message of ROS 2 will arrive between {apart}: they share the host's network, but not its memory, which "
            "Fast DDS uses; write `ipc: host` and the same `user:` into each of them, or "
            "`FASTDDS_BUILTIN_TRANSPORTS: UDPv4` under `environment:`"
        )
    if strangers:
        found.append(
            f"no message of ROS 2 will arrive between {strangers}: one of them runs as root, and Fast DDS does not share "
            "memory with another user then; write the same `user:` into each of them"
        )
    return tuple(found)


def _together(pairs: Iterator[tuple[str, str]]) -> str:
    """Return the names in pairs, each once: ``a, b and c``; "" without any."""
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    return f"{', '.join(names[:-1])} and {names[-1]}" if names else ""


def _by_shared_memory(service: Mapping[str, Any], *, version: int) -> bool:
    """Whether a service has nodes of ROS 2 on the host's network that talk by shared memory, as far as its file tells."""
    environment = service.get("environment") or {}
    marked = bool(_ROS_2 & environment.keys())
    by_version = version == 2 and (
        any(name.startswith("ROS_") for name in environment) or is_ros(str(service.get("image") or ""))
    )
    middleware = str(environment.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp")
    transports = str(environment.get("FASTDDS_BUILTIN_TRANSPORTS") or "")
    return (
        service.get("network_mode") == "host"
        and (marked or by_version)
        and middleware.startswith("rmw_fastrtps")
        and not transports.startswith("UDP")
        and not any(name.startswith("FASTRTPS_DEFAULT_PROFILES") for name in environment)
    )


def is_ros(image: str) -> bool:
    """Whether an image is one of the ROS project."""
    name = image.partition("@")[0]
    return name.rpartition("/")[2].partition(":")[0] in {"ros", "ros2"} or name.startswith("osrf/ros")


def _memory(name: str, services: Mapping[str, Any]) -> str:
    """Return whose shared memory a service has: ``host``, or the name of a service or container."""
    seen: set[str] = set()
    while name not in seen:
        seen.add(name)
        ipc = str((services.get(name) or {}).get("ipc") or "")
        if ipc == "host":
            return "host"
        if not ipc.startswith(("service:", "container:")):
            return name
        name = ipc.partition(":")[2]
    return name


def _root_beside_another(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether one of two services says that it runs as root, and the other one that it does not."""
    users = [str(service.get("user") or "").partition(":")[0] for service in (one, other)]
    return all(users) and len({user in _ROOT for user in users}) == 2
