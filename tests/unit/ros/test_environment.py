from __future__ import annotations

import pytest

from fleet.config import validation
from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.ros import environment


def robot(address: str = "pi1.local", **settings: str) -> Robot:
    return Robot(name="pi1", address=address, ros=Ros.model_validate(settings))


@pytest.mark.parametrize("address", ["pi1.local", "192.168.1.21"])
def test_robot_with_its_own_master(address: str) -> None:
    """By default a robot is its own master, and others call it by its address."""
    assert environment.environment(robot(address)) == {
        "ROS_MASTER_URI": "http://localhost:11311",
        "ROS_HOSTNAME": address,
    }


def test_robot_on_a_shared_master() -> None:
    """A shared master is named as it is; hostname and namespace are the robot's own."""
    shared = robot(master="http://base:11311", hostname="arm", namespace="/site/arm")
    assert environment.environment(shared) == {
        "ROS_MASTER_URI": "http://base:11311",
        "ROS_HOSTNAME": "arm",
        "ROS_NAMESPACE": "/site/arm",
    }


def test_ip_replaces_the_hostname() -> None:
    """ROS_HOSTNAME would win over ROS_IP, so only one of them is there; none is ever empty."""
    variables = environment.environment(robot(ip="10.0.0.7"))
    assert variables["ROS_IP"] == "10.0.0.7"
    assert "ROS_HOSTNAME" not in variables
    assert all(variables.values())


def test_robot_with_ros_2() -> None:
    """Nothing of ROS 1; the peers are addresses; without values only the domain is there, so that no other one counts."""
    said = Ros(
        version=2, domain=7, rmw="rmw_cyclonedds_cpp", discovery="off", peers=["fleet"], namespace="pi1"
    )
    full = Robot(name="pi1", address="pi1.local", ros=said, peers=("10.0.0.2", "pi3.local"))
    assert environment.environment(full) == {
        "ROS_DOMAIN_ID": "7",
        "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF",
        "ROS_STATIC_PEERS": "10.0.0.2;pi3.local",
        "ROS_NAMESPACE": "/pi1",
    }
    plain = Robot(name="pi1", address="pi1.local", ros=Ros(version=2))
    assert environment.environment(plain) == {"ROS_DOMAIN_ID": "0"}


def test_desktop_finds_a_robots_own_master_at_the_robot() -> None:
    """What the robot calls localhost is, for the desktop, its address, or else the name it gives itself."""
    assert environment.masters(robot("alias", hostname="pi1.lan")) == (
        "http://alias:11311",
        "http://pi1.lan:11311",
    )


def test_desktop_finds_a_loopback_master_at_the_robot() -> None:
    """A master at localhost, with a port of its own, is the robot's own."""
    assert environment.masters(robot("10.0.0.7", master="http://127.0.0.1:11312")) == (
        "http://10.0.0.7:11312",
    )


def test_desktop_finds_a_shared_master_where_it_is() -> None:
    """A shared master has one URI for everybody."""
    assert environment.masters(robot(master="http://base:11311")) == ("http://base:11311",)


def test_ipv6_address_in_a_uri() -> None:
    """An IPv6 address stands in brackets in a URI."""
    assert environment.masters(robot("fd00::7")) == ("http://[fd00::7]:11311",)


@pytest.mark.parametrize(
    ("host", "answer"),
    [("localhost", True), ("127.0.1.1", True), ("::1", True), ("10.127.0.1", False), ("pi1", False)],
)
def test_is_loopback(host: str, answer: bool) -> None:
    """Only names and addresses that mean every computer itself."""
    assert environment.is_loopback(host) is answer


def test_an_inventory_reserves_each_variable_that_is_set_here() -> None:
    """`config` lies below `ros` and cannot import its table."""
    ours = {name for names in environment.VARIABLES.values() for name in names}
    assert ours == set(validation.RESERVED) - {"COMPOSE_PROJECT_NAME"}
