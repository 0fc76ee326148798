"""Does an image have the middleware that a service of ROS 2 asks for?

Each middleware (RMW) has a file with its name in the index of the packages of ROS:
https://github.com/ament/ament_cmake/blob/rolling/ament_cmake_core/doc/resource_index.md. Pure: names in, a sentence out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

_INDEX = "share/ament_index/resource_index/rmw_typesupport"
_NOT_ONE = "rmw_implementation"  # chooses one of the others


def folders(environment: Mapping[str, str]) -> tuple[str, ...]:
    """Return the folders with the names of an image's middlewares, by the variables of the image; none without ROS 2."""
    prefixes = [prefix for prefix in environment.get("AMENT_PREFIX_PATH", "").split(":") if prefix]
    if distribution := environment.get("ROS_DISTRO", ""):
        prefixes.append(f"/opt/ros/{distribution}")
    return tuple(dict.fromkeys(f"{prefix}/{_INDEX}" for prefix in prefixes))


def warning(wanted: str, *, service: str, image: str, there: Collection[str]) -> str:
    """Return a sentence if an image lacks the middleware that a service asks for, "" otherwise.

    ``there`` are the names in its `folders`; without any, the image has its ROS elsewhere, and nothing is known.
    """
    found = sorted(set(there) - {_NOT_ONE})
    if not found or wanted in found:
        return ""
    package = wanted.replace("_", "-")
    return (
        f"the nodes of the service {service} will not start: {image} has no {wanted}, only {', '.join(found)}; install "
        f"ros-$ROS_DISTRO-{package} in the Dockerfile, or change `rmw:` under `ros:` in the inventory"
    )
