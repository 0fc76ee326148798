"""Which ROS environment does a robot get, and where does the desktop find its master?

https://wiki.ros.org/ROS/EnvironmentVariables and https://wiki.ros.org/ROS/NetworkSetup say what the variables mean.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from fleet.config.inventory import Robot

MASTER_PORT = 11311
OWN = "own"

VARIABLES = ("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "ROS_NAMESPACE")
"""The variables that `environment` sets."""


def environment(robot: Robot) -> dict[str, str]:
    """Return the ROS variables of a robot's containers; one that is not set is not there (ROS chokes on empty ones).

    ``ROS_HOSTNAME`` or ``ROS_IP`` is what its nodes tell others to call them by. Unless the inventory says otherwise
    it is the robot's address, name or IP alike: ``ROS_HOSTNAME`` takes both.
    """
    own_master = f"http://localhost:{MASTER_PORT}"
    values = (
        own_master if robot.ros.master == OWN else robot.ros.master,
        None if robot.ros.ip else robot.ros.hostname or robot.address,
        robot.ros.ip,
        robot.ros.namespace,
    )
    return {name: value for name, value in zip(VARIABLES, values, strict=True) if value}


def own_names(robot: Robot) -> tuple[str, ...]:
    """Return what a robot may be called by, the most trusted first: its address has been logged in at.

    The address may be an alias that only OpenSSH's configuration knows; then one of the others has to do.
    """
    names = (robot.address, robot.ros.hostname, robot.ros.ip)
    return tuple(dict.fromkeys(name for name in names if name))


def masters(robot: Robot) -> tuple[str, ...]:
    """Return the URIs where the desktop may find the robot's master, best first.

    A robot's own master is at localhost for the robot, and at the robot's address for everybody else.
    """
    if not has_own_master(robot):
        return (robot.ros.master,)
    port = MASTER_PORT if robot.ros.master == OWN else urlsplit(robot.ros.master).port or MASTER_PORT
    return tuple(f"http://{_in_uri(name)}:{port}" for name in own_names(robot))


def has_own_master(robot: Robot) -> bool:
    """Whether the robot runs a master of its own, rather than sharing one."""
    return robot.ros.master == OWN or is_loopback(urlsplit(robot.ros.master).hostname or "")


def is_loopback(host: str) -> bool:
    """Whether a host name or IP address means "this computer" on every computer."""
    return host in {"localhost", "::1"} or host.startswith("127.")


def _in_uri(host: str) -> str:
    return f"[{host}]" if ":" in host else host
