from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fleet.config.inventory import Robot, StackFiles
from fleet.config.ros import Ros
from fleet.ros.unused_settings import warnings
from tests.support.samples import stack

ONE, TWO = StackFiles(files=(Path("a"),)), StackFiles(files=(Path("b"),))


def robot(*, stacks: tuple[StackFiles, ...] = (ONE,), peers: tuple[str, ...] = (), **ros: Any) -> Robot:  # noqa: ANN401
    return Robot(
        name="pi1", address="a", stacks=stacks, peers=peers, ros=Ros.model_validate({"version": 2, **ros})
    )


def node(*names: str, image: str = "mine", **values: str | None) -> dict[str, Any]:
    return {"image": image, "environment": {**dict.fromkeys(names), **values}}


def test_a_variable_that_no_service_gets() -> None:
    """All of them in one sentence; a domain that is not said is not missed."""
    full = robot(domain=7, rmw="rmw_cyclonedds_cpp", peers=("10.0.0.2",), namespace="x")
    (text,) = warnings(full, stack(a=node("RMW_IMPLEMENTATION"), b=node("COLOUR")))
    assert text == (
        "no service of the stack talker gets ROS_DOMAIN_ID, ROS_STATIC_PEERS, which the inventory sets; name them "
        "under `environment:` of the services that have nodes"
    )
    (text,) = warnings(robot(domain=7), stack(a={"image": "mine"}))
    assert "gets ROS_DOMAIN_ID, which the inventory sets; name it under" in text
    assert warnings(robot(), stack(a={"image": "mine"})) == ()


def test_every_variable_is_passed_on() -> None:
    """Nothing to say."""
    full = robot(domain=7, discovery="subnet")
    assert warnings(full, stack(a=node("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"))) == ()
    assert warnings(full, stack(a=node(ROS_DOMAIN_ID="7", ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET"))) == ()


def test_a_stack_without_ros_beside_another() -> None:
    """Only a robot's one stack is expected to have nodes."""
    web = stack(web={"image": "nginx"})
    assert warnings(robot(domain=7, stacks=(ONE, TWO)), web) == ()
    assert len(warnings(robot(domain=7), web)) == 1
    assert len(warnings(robot(domain=7, stacks=(ONE, TWO)), stack(a=node(image="ros:jazzy")))) == 1


def test_a_service_with_a_value_of_its_own() -> None:
    """`fab listen` would look for it in the wrong domain, so the domain 0 of an inventory that says nothing counts, too."""
    (text,) = warnings(robot(domain=7), stack(a=node(ROS_DOMAIN_ID="5"), b=node("ROS_DOMAIN_ID")))
    assert text == (
        "the service a has ROS_DOMAIN_ID=5, and the inventory says 7; write `ROS_DOMAIN_ID` without a value"
    )
    assert "the inventory says 0" in warnings(robot(), stack(a=node(ROS_DOMAIN_ID="5")))[0]


@pytest.mark.parametrize("image", ["ros:humble-ros-core", "osrf/ros:humble-desktop"])
def test_a_distribution_that_ignores_a_setting(image: str) -> None:
    """As far as the name of the image tells."""
    service = node("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DOMAIN_ID", image=image)
    (text,) = warnings(robot(discovery="localhost"), stack(a=service))
    assert text == "the service a has ROS Humble, which ignores ros.discovery"
    assert warnings(robot(domain=3), stack(a=service)) == ()
    newer = node("ROS_AUTOMATIC_DISCOVERY_RANGE", image="ros:jazzy")
    assert warnings(robot(discovery="localhost"), stack(a=newer)) == ()


def test_robots_with_ros_1() -> None:
    """Their variables are not looked at here."""
    assert warnings(Robot(name="pi1", address="a"), stack(a={"image": "mine"})) == ()
