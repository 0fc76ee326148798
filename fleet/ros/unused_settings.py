"""Which ROS 2 settings of the inventory will not reach the nodes of a stack?

A Compose file gives a container only the variables that it names. A stack without them starts well, and its nodes are in
domain 0, whatever the inventory says. Pure: a robot and its stack in, sentences out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fleet.ros import environment
from fleet.ros.silent_stack import is_ros

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.inventory import Robot
    from fleet.config.stack import Stack

_OLD = ("foxy", "galactic", "humble")
"""Distributions that do not know the newer variables of discovery."""

_NEWER = {"discovery": "ROS_AUTOMATIC_DISCOVERY_RANGE", "peers": "ROS_STATIC_PEERS"}


def warnings(robot: Robot, stack: Stack) -> tuple[str, ...]:
    """Return a sentence for each kind of setting that will have no effect in a stack of a robot."""
    if robot.ros.version != 2:
        return ()
    services: Mapping[str, Mapping[str, Any]] = stack.model.get("services") or {}
    nodes = {name: value for name, value in services.items() if _has_nodes(value)}
    if not nodes and len(robot.stacks) > 1:
        return ()  # a stack without ROS beside another one
    return (*_not_passed(robot, stack.name, services), *_other_values(robot, nodes), *_unknown(robot, nodes))


def _has_nodes(service: Mapping[str, Any]) -> bool:
    variables = service.get("environment") or {}
    return any(name.startswith(("ROS_", "RMW_")) for name in variables) or is_ros(
        str(service.get("image") or "")
    )


def _set(robot: Robot) -> dict[str, str]:
    """Return the variables that the inventory sets. ROS_NAMESPACE is for the command, where it cannot be seen."""
    found = environment.environment(robot)
    found.pop("ROS_NAMESPACE", None)
    if robot.ros.domain is None:
        del found["ROS_DOMAIN_ID"]
    return found


def _not_passed(robot: Robot, stack: str, services: Mapping[str, Mapping[str, Any]]) -> list[str]:
    passed = {name for service in services.values() for name in service.get("environment") or {}}
    missing = [name for name in _set(robot) if name not in passed]
    if not missing:
        return []
    return [
        (
            f"no service of the stack {stack} gets {', '.join(missing)}, which the inventory sets; name "
            f"{'it' if len(missing) == 1 else 'them'} under `environment:` of the services that have nodes"
        )
    ]


def _other_values(robot: Robot, nodes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return [
        f"the service {name} has {variable}={found}, and the inventory says {wanted}; write `{variable}` without a value"
        for name, service in nodes.items()
        for variable, wanted in environment.environment(robot).items()
        if variable != "ROS_NAMESPACE"
        and (found := (service.get("environment") or {}).get(variable)) is not None
        and str(found) != wanted
    ]


def _unknown(robot: Robot, nodes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    keys = [key for key in _NEWER if getattr(robot.ros, key)]
    images = {name: str(service.get("image") or "") for name, service in nodes.items()}
    old = {
        name: distribution
        for name, image in images.items()
        for distribution in _OLD
        if is_ros(image) and image.rpartition(":")[2].startswith(distribution)
    }
    return [
        f"the service {name} has ROS {distribution.title()}, which ignores ros.{' and ros.'.join(keys)}"
        for name, distribution in old.items()
        if keys
    ]
