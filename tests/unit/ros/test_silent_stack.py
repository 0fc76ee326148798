from __future__ import annotations

from typing import Any

import pytest

from fleet.ros.silent_stack import warnings
from tests.support.samples import stack


def node(**values: Any) -> dict[str, Any]:  # noqa: ANN401  whatever a service has
    """A service with a node of ROS 2 on the host's network."""
    own: dict[str, Any] = {"image": "mine", "network_mode": "host", "environment": {"ROS_DOMAIN_ID": "7"}}
    return {**own, **values}


def said(version: int = 2, **services: dict[str, Any]) -> tuple[str, ...]:
    return warnings(stack(**services), version=version)


def test_two_services_with_a_shared_memory_each() -> None:
    """Both are named, with the lines that cure it; ROS_DOMAIN_ID is reason enough for a robot that says no version."""
    for version in (1, 2):
        (text,) = said(
            version, talker=node(), listener=node(), web={"image": "nginx", "network_mode": "host"}
        )
        assert text.startswith("no message of ROS 2 will arrive between talker and listener: ")
        assert "`ipc: host` and the same `user:`" in text
        assert "`FASTDDS_BUILTIN_TRANSPORTS: UDPv4`" in text


def test_three_services_are_one_sentence() -> None:
    """One that shares with another is still apart from the third."""
    (text,) = said(a=node(ipc="host"), b=node(ipc="host"), c=node())
    assert "between a, c and b" in text


@pytest.mark.parametrize(
    "changes",
    [
        {"ipc": "host"},
        {"network_mode": "bridge"},
        {"network_mode": None},
        {"environment": {"ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}},
        {"environment": {"ROS_DOMAIN_ID": "7", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}},
        {"environment": {"ROS_DOMAIN_ID": "7", "FASTRTPS_DEFAULT_PROFILES_FILE": "/fast.xml"}},
        {"environment": {"COLOUR": "red"}},
        {"environment": None},
    ],
)
def test_stacks_that_are_well(changes: dict[str, Any]) -> None:
    """One memory, other networks, other middlewares and transports, a person's own profiles, and programs without ROS."""
    assert said(a=node(**changes), b=node(**changes)) == ()


def test_one_memory_by_the_name_of_a_service() -> None:
    """Compose has a form for that, too; a circle of them does not hang."""
    assert said(a=node(ipc="shareable"), b=node(ipc="service:a")) == ()
    assert said(a=node(ipc="container:x"), b=node(ipc="container:x")) == ()
    assert said(a=node(ipc="service:b"), b=node(ipc="service:a"))
    assert len(said(a=node(ipc="shareable"), b=node(ipc="private"))) == 1


def test_root_beside_another_user() -> None:
    """Only if both say who they are: the user of an image is not in the file."""
    (text,) = said(a=node(ipc="host", user="root"), b=node(ipc="host", user="1000:1000"))
    assert "between a and b: one of them runs as root" in text
    for one, other in (("0", "root"), ("1000", "1001"), ("", "root")):
        assert said(a=node(ipc="host", user=one), b=node(ipc="host", user=other)) == ()


def test_signs_of_ros_that_need_the_robots_version() -> None:
    """ROS_NAMESPACE is ROS 1's as well, and an image of the ROS project may be either."""
    for sign in (
        {"environment": {"ROS_NAMESPACE": "a"}},
        {"image": "ros:jazzy-ros-core", "environment": {}},
        {"image": "docker.io/library/ros:jazzy@sha256:1", "environment": {}},
        {"image": "osrf/ros:jazzy-desktop", "environment": {}},
    ):
        assert said(2, a=node(**sign), b=node(**sign))
        assert said(1, a=node(**sign), b=node(**sign)) == ()


def test_a_middleware_that_is_named_and_is_fast_dds() -> None:
    """A bare name without a value is the image's own, and so most likely Fast DDS."""
    for value in ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", None):
        other = {"environment": {"RMW_IMPLEMENTATION": value}}
        assert said(a=node(**other), b=node(**other))
