from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.errors import NotAsPlanned, Unreachable
from fleet.ros import topics
from fleet.ros.quality import Quality
from fleet.ros.rtps_discovery import Endpoint
from fleet.ros.rtps_graph import Graph
from fleet.ros.topics import Topic
from tests.support.ros2_peer import Peer, string_message
from tests.support.ros_peers import Peers, answering

if TYPE_CHECKING:
    from fleet.ros.listen_ros2 import OnRobot

CHATTER = Topic(name="/chatter", type="std_msgs/msg/String", publishers=1, quality="reliable, volatile")
SILENT: OnRobot = lambda _: "== udp\n== igmp\n== containers\n== end\n"  # noqa: E731  what a robot says that has nothing


def robot_of(master: str) -> Robot:
    return Robot(name="pi1", address="127.0.0.1", ros=Ros(master=master))


@pytest.fixture
def domain() -> int:
    """A domain for each process of a test run."""
    return 5 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])


def test_topics_of_a_master() -> None:
    """Sorted, with their types; one that the master has no type of is listed without."""
    state = [1, "", [[["/time", ["/a", "/b"]], ["/scan", ["/a"]]], [["/cmd", ["/a"]], ["/scan", ["/b"]]], []]]
    types = [1, "", [["/time", "std_msgs/Time"], ["/other", "x/Y"], "odd"]]
    with answering({"getSystemState": lambda _: state, "getTopicTypes": lambda _: types}) as port:
        assert topics.topics(robot_of(f"http://127.0.0.1:{port}"), timeout=5, on_robot=SILENT) == (
            Topic(name="/scan", type="", publishers=1, subscribers=1),
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
    assert found == (CHATTER,)


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
    graph = Graph(prefix=bytes(12), domain=0, place=("10.0.0.9", 1), addresses=())

    def endpoint(number: int, topic: str, kind: str, *, reliable: bool = True) -> Endpoint:
        return Endpoint(guid=bytes([number] * 16), topic=topic, type=kind, quality=Quality(reliable=reliable))

    string = "std_msgs::msg::dds_::String_"
    writers = [
        endpoint(1, "rt/a", string),
        endpoint(2, "rt/a", string, reliable=False),
        endpoint(3, "rt/b", "Odd", reliable=False),
        endpoint(4, "rq/xRequest", string),
        endpoint(5, "ros_discovery_info", "x"),
        endpoint(6, "rt", "x"),
    ]
    graph.writers.update({writer.guid: writer for writer in writers})
    wants = endpoint(7, "rt/b", "Odd")
    graph.readers[wants.guid] = wants
    assert topics.of_graph(graph, rates={"rt/a": 2.0}) == (
        Topic(
            name="/a", type="std_msgs/msg/String", publishers=2, rate=2.0,
            quality="best effort, volatile; reliable, volatile",
        ),
        Topic(
            name="/b", type="Odd", publishers=1, subscribers=1, quality="best effort, volatile",
            unmatched=("it wants reliable messages, and the publisher is best effort",),
        ),
    )  # fmt: skip


def test_rates_of_nodes(domain: int) -> None:
    """All topics are counted; large messages too, without keeping them."""
    ros = Ros(version=2, domain=domain)
    for piece in (0, 1000):
        with Peer(domain=domain, messages=[string_message("x" * 5000)] * 100, piece=piece).run():
            (found,) = topics.topics(
                Robot(name="pi1", address="127.0.0.1", ros=ros), timeout=5, on_robot=SILENT, measure=1.5
            )
        assert found.rate is not None
        assert 5 < found.rate < 25


def test_messages_per_second() -> None:
    """From the first to the last, if they come regularly."""
    assert topics.per_second([number / 10 for number in range(50)], 5) == pytest.approx(10)
    assert topics.per_second([1.0, 3.0], 5) == 0.5
    assert topics.per_second([1.0], 5) == 0.2
    assert topics.per_second([], 5) == 0


@pytest.mark.parametrize("times", [[2.0, 2.001, 2.002], [2.0, 2.0, 2.0], [0.0, 0.001, 0.002]])
def test_a_burst_is_no_rate(times: list[float]) -> None:
    """Three messages in five seconds are not a thousand in one."""
    assert topics.per_second(times, 5) == pytest.approx(0.6)
