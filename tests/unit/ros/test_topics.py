from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Robot, Ros
from fleet.errors import NotAsPlanned, Unreachable
from fleet.ros import topics
from fleet.ros.rtps import Writer
from fleet.ros.topics import Topic
from tests.support.ros2_peer import Peer
from tests.support.ros_peers import Peers, answering

if TYPE_CHECKING:
    from fleet.ros.listen_ros2 import OnRobot

SILENT: OnRobot = lambda _: "== udp\n== igmp\n== containers\n== end\n"  # noqa: E731  what a robot says that has nothing


def robot_of(master: str) -> Robot:
    return Robot(name="pi1", address="127.0.0.1", ros=Ros(master=master))


@pytest.fixture
def domain() -> int:
    """A domain for each process of a test run."""
    return 5 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])


def test_topics_of_a_master() -> None:
    """Sorted, with their types; one that the master has no type of is listed without."""
    state = [1, "", [[["/time", ["/a", "/b"]], ["/scan", ["/a"]]], [["/cmd", ["/a"]]], []]]
    types = [1, "", [["/time", "std_msgs/Time"], ["/other", "x/Y"], "odd"]]
    with answering({"getSystemState": lambda _: state, "getTopicTypes": lambda _: types}) as port:
        assert topics.topics(robot_of(f"http://127.0.0.1:{port}"), timeout=5, on_robot=SILENT) == (
            Topic(name="/scan", type="", publishers=1),
            Topic(name="/time", type="std_msgs/Time", publishers=2),
        )


def test_a_master_that_knows_no_types() -> None:
    """Its refusal is told as for `fab listen`."""
    with Peers().run() as peers, pytest.raises(NotAsPlanned, match="is not a working ROS master"):
        topics.topics(robot_of(peers.master), timeout=5, on_robot=SILENT)


def test_topics_of_nodes(domain: int) -> None:
    """They are found as a listener finds them."""
    ros = Ros(version=2, domain=domain)
    with Peer(domain=domain).run():
        found = topics.topics(Robot(name="pi1", address="127.0.0.1", ros=ros), timeout=5, on_robot=SILENT)
    assert found == (Topic(name="/chatter", type="std_msgs/msg/String", publishers=1),)


def test_no_nodes(domain: int) -> None:
    """The reason is told."""
    away = Robot(name="pi1", address="127.0.0.1", ros=Ros(version=2, domain=domain))
    with pytest.raises(NotAsPlanned, match="no container runs on pi1"):
        topics.topics(away, timeout=0.3, on_robot=SILENT)
    with Peer(domain=domain, answers=False).run(), pytest.raises(Unreachable, match="announce themselves"):
        topics.topics(away, timeout=1, on_robot=SILENT)
    zenoh = away.model_copy(update={"ros": Ros(version=2, rmw="rmw_zenoh_cpp")})
    with pytest.raises(NotAsPlanned, match="rmw_zenoh_cpp"):
        topics.topics(zenoh, timeout=30, on_robot=SILENT)


def test_only_topics_are_listed() -> None:
    """Services have other prefixes; a topic with two types is two rows; types without ROS's form stay as they are."""

    def writer(topic: str, kind: str) -> Writer:
        return Writer(guid=bytes(16), topic=topic, type=kind, reliable=True, durable=False)

    string = "std_msgs::msg::dds_::String_"
    writers = [
        writer("rt/a", string),
        writer("rt/a", string),
        writer("rt/a", "Odd"),
        writer("rq/xRequest", string),
    ]
    writers += [writer("ros_discovery_info", "x"), writer("rt", "x")]
    assert topics.of_writers(writers) == (
        Topic(name="/a", type="Odd", publishers=1),
        Topic(name="/a", type="std_msgs/msg/String", publishers=2),
    )
