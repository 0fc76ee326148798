"""Which ROS variables does a robot get, and where does the desktop find its ROS master?

https://wiki.ros.org/ROS/EnvironmentVariables and https://wiki.ros.org/ROS/NetworkSetup say what the variables mean.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from fleet.config.inventory import Robot

MASTER_PORT = 11311
OWN = "own"

VARIABLES = {
    1: ("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "ROS_NAMESPACE"),
    2: (
        *("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"),
        "ROS_NAMESPACE",
    ),
}
"""The variables that `environment` sets, for each version of ROS."""


def environment(robot: Robot) -> dict[str, str]:
    """Return the ROS variables of a robot's containers; a variable without a value is left out, because ROS fails on empty ones.

    ``ROS_HOSTNAME`` or ``ROS_IP`` is the address that the robot's nodes register with the master. The default is the
    robot's address, a name or an IP address: ``ROS_HOSTNAME`` accepts both.
    """
    return (_ros2 if robot.ros.version == 2 else _ros1)(robot)


def _ros2(robot: Robot) -> dict[str, str]:
    """Return the variables of ROS 2; ROS_NAMESPACE is for the stack's command line, because no node of ROS 2 reads it."""
    ros = robot.ros
    values = (
        str(domain(robot)),
        ros.rmw,
        (ros.discovery or "").upper(),
        ";".join(robot.peers),
        ros.namespace and f"/{ros.namespace.strip('/')}",
    )
    return {name: value for name, value in zip(VARIABLES[2], values, strict=True) if value}


def domain(robot: Robot) -> int:
    """Return the ROS 2 domain of a robot."""
    return robot.ros.domain or 0


def _ros1(robot: Robot) -> dict[str, str]:
    own_master = f"http://localhost:{MASTER_PORT}"
    values = (
        own_master if robot.ros.master == OWN else robot.ros.master,
        None if robot.ros.ip else robot.ros.hostname or robot.address,
        robot.ros.ip,
        robot.ros.namespace,
    )
    return {name: value for name, value in zip(VARIABLES[1], values, strict=True) if value}


def own_names(robot: Robot) -> tuple[str, ...]:
    """Return a robot's names, the most reliable first: SSH logs in at its address.

    The address may be an alias of OpenSSH's configuration; then one of the others is needed.
    """
    names = (robot.address, robot.ros.hostname, robot.ros.ip)
    return tuple(dict.fromkeys(name for name in names if name))


def masters(robot: Robot) -> tuple[str, ...]:
    """Return the URIs where the desktop may find the robot's master, best first.

    The robot reaches its own master at localhost; all others reach it at the robot's address.
    """
    if not has_own_master(robot):
        return (robot.ros.master,)
    port = MASTER_PORT if robot.ros.master == OWN else urlsplit(robot.ros.master).port or MASTER_PORT
    return tuple(f"http://{_in_uri(name)}:{port}" for name in own_names(robot))


def has_own_master(robot: Robot) -> bool:
    """Whether the robot runs its own master, and does not share one."""
    return robot.ros.master == OWN or is_loopback(urlsplit(robot.ros.master).hostname or "")


def is_loopback(host: str) -> bool:
    """Whether a host name or IP address means "this computer" on every computer."""
    return host in {"localhost", "::1"} or host.startswith("127.")


def _in_uri(host: str) -> str:
    return f"[{host}]" if ":" in host else host
