from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.errors import NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.ros import silence
from fleet.ros.rtps_graph import Graph
from fleet.ros.silence import Container, Network
from tests.support.ros2_peer import announcement, datagram, parameter, publication

PEER = b"\1\x0f" + bytes(10)
UDP = """   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref pointer drops
 5563: 00000000:1CE8 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 7889676 2 0000000000000000 0
 5573: 00000000:1CF2 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 7889675 2 0000000000000000 0
 5574: 00000000:1CF3 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 7889680 2 0000000000000000 0
 6846: 02004D0A:B7EC 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 7889684 2 0000000000000000 0
"""  # domain 0, and a port of a resolver that looks like domain 158
IGMP = """Idx	Device    : Count Querier	Group    Users Timer	Reporter
1	lo        :     2      V3
				0100FFEF     1 0:00000000		0
				010000E0     1 0:00000000		0
2	eth0      :     2      V3
				0100FFEF     1 0:00000000		0
3	docker0   :     1      V3
				010000E0     1 0:00000000		0
"""
SAID = f"""== ssh
10.0.0.9 51234 10.0.0.2 22
== udp
{UDP}== igmp
{IGMP}== containers
/nav-1 host
 ROS_DOMAIN_ID=7
 RMW_IMPLEMENTATION=rmw_cyclonedds_cpp
/web bridge
== end
"""


def robot(**ros: object) -> Robot:
    return Robot(name="pi1", address="10.0.0.2", ros=Ros.model_validate({"version": 2, **ros}))


def graph(*datagrams: bytes, topic: str = "/chatter", domain: int = 0) -> Graph:
    listener = Graph(
        prefix=b"\1\x42" + bytes(10),
        domain=domain,
        place=("10.0.0.9", 1),
        addresses=("10.0.0.2",),
        topic=topic,
    )
    for one in datagrams:
        list(listener.receive(one, source="10.0.0.2", multicast=False, now=0))
    return listener


def reason(
    heard: Graph, network: Network | None = None, *, before: int = 0, of: Robot | None = None
) -> RobotError:
    found = silence.reason(of or robot(), heard, network or Network(), heard=before, timeout=5)
    assert found.cure
    assert not found.what.endswith(".")
    return found


HERE = announcement(PEER, ("10.0.0.2", 7410))


def test_what_the_robot_says() -> None:
    """The address of SSH, domains, interfaces, and containers with their settings."""
    assert silence.read(SAID) == Network(
        address="10.0.0.2",
        domains={0: frozenset({0, 10, 11})},
        interfaces=frozenset({"lo", "eth0"}),
        containers=(
            Container(
                name="nav-1",
                network="host",
                settings={"ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
            ),
            Container(name="web", network="bridge", settings={}),
        ),
    )


@given(
    st.text() | st.text(st.sampled_from("=/ :\n0123ABCDFEhost")).map(lambda part: SAID.replace("host", part))
)
def test_whatever_the_robot_says(text: str) -> None:
    """Nothing raises."""
    silence.reason(robot(), graph(), silence.read(text), heard=0, timeout=5)


def test_another_domain() -> None:
    """The one that its nodes are in is named."""
    found = reason(graph(), Network(domains={7: frozenset({0, 10, 11})}), of=robot(domain=3))
    assert found.what == "the nodes of pi1 are in domain 7, and the inventory says 3"
    assert "`ros: {domain: 7}`" in found.cure


@pytest.mark.parametrize("value", ["LOCALHOST", "OFF"])
def test_nodes_that_look_for_nobody(value: str) -> None:
    """The variable and its container are named; without them, the ports tell."""
    container = Container(name="nav-1", network="host", settings={"ROS_AUTOMATIC_DISCOVERY_RANGE": value})
    found = reason(graph(), Network(domains={0: frozenset({0, 10, 11})}, containers=(container,)))
    assert f"ROS_AUTOMATIC_DISCOVERY_RANGE={value} in nav-1" in found.what
    assert "ros.discovery of pi1" in found.cure
    assert "ROS_DISCOVERY_SERVER" in reason(graph(), Network(domains={0: frozenset({10, 11})})).what


def test_loopback_only() -> None:
    """ROS_LOCALHOST_ONLY of Humble."""
    network = Network(domains={0: frozenset({0, 10, 11})}, interfaces=frozenset({"lo"}))
    found = reason(graph(), network)
    assert "loopback interface only" in found.what
    assert "ROS_LOCALHOST_ONLY" in found.cure


def test_a_firewall_or_a_network_without_multicast() -> None:
    """Everything is as it should be, and nothing arrives: the ports of the domain are named."""
    network = Network(domains={7: frozenset({0, 10, 11})}, interfaces=frozenset({"lo", "eth0"}))
    found = reason(graph(domain=7), network, of=robot(domain=7))
    assert isinstance(found, Unreachable)
    assert "the ports 9150 to 9399" in found.cure
    assert "ros.peers of pi1" in found.cure


def test_nodes_that_hear_nothing() -> None:
    """They announce themselves, but the questions do not reach them."""
    found = reason(graph(HERE))
    assert isinstance(found, Unreachable)
    assert found.what == "the nodes of pi1 announce themselves, but do not answer this computer"


def test_a_container_with_a_network_of_its_own() -> None:
    """Only one that has to do with ROS is blamed."""
    web = Container(name="web", network="bridge", settings={})
    nav = Container(name="nav-1", network="nav_default", settings={"ROS_DISTRO": "jazzy"})
    found = reason(graph(), Network(containers=(web, nav)))
    assert found.what == "nav-1 has a network of its own (nav_default), which no other computer can look into"
    assert "`network_mode: host`" in found.cure
    assert "speaks DDS" in reason(graph(), Network(containers=(web,))).what
    assert reason(graph(), Network()).what == "no container runs on pi1"


def test_zenoh() -> None:
    """Its container is named, because messages can be heard there."""
    zenoh = Container(name="nav-1", network="host", settings={"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"})
    found = reason(graph(), Network(containers=(zenoh,)))
    assert found.what.startswith("nav-1 uses rmw_zenoh_cpp")
    assert "`fab listen --via robot`" in found.cure


def test_security() -> None:
    """SROS 2 tells nobody its topics who has no key."""
    found = reason(graph(announcement(PEER, ("10.0.0.2", 7410), extra=parameter(0x1001, bytes(8)))))
    assert "SROS 2" in found.what


@pytest.mark.parametrize(
    ("topic", "cure"),
    [
        ("/chattr", "did you mean /chatter?"),
        ("/pi1/chatter", "did you mean /chatter?"),
        ("/odometry", "published are /chatter, /rosout"),
    ],
)
def test_a_topic_that_nobody_publishes(topic: str, cure: str) -> None:
    """Near names are offered; services and programs without ROS are not topics."""
    names = ("rt/chatter", "rt/rosout", "rr/talker/get_parametersReply", "ros_discovery_info")
    published = [
        publication(PEER, number, name, writer=bytes((0, 0, number, 3)))
        for number, name in enumerate(names, 1)
    ]
    found = reason(graph(HERE, datagram(PEER, *published), topic=topic))
    assert isinstance(found, NotAsPlanned)
    assert (found.what, found.cure) == (f"there is no topic {topic}", cure)


def test_a_publisher_that_does_not_answer() -> None:
    """It was found, and never took note of the subscription."""
    found = reason(graph(HERE, datagram(PEER, publication(PEER, 1, "rt/chatter"))))
    assert found.what == "the publisher of /chatter does not answer the subscription of this computer"


def test_a_publisher_that_sends_nothing() -> None:
    """It took note; or messages have come before."""
    listener = graph(HERE, datagram(PEER, publication(PEER, 1, "rt/chatter")))
    silent = "/chatter was silent for 5 s: its publisher took the subscription and sent nothing in that time"
    assert reason(listener, before=3).what == silent
    listener.peers[PEER].knows_us = True
    found = reason(listener)
    assert isinstance(found, TimedOut)
    assert (found.what, found.cure) == (
        silent,
        "`fab logs --hosts pi1` shows what the node does; a slower topic needs a longer --timeout",
    )


def test_large_messages_that_lose_parts() -> None:
    """The size, and what makes room."""
    listener = graph(HERE, datagram(PEER, publication(PEER, 1, "rt/chatter")))
    listener.incomplete = 8_000_000
    found = reason(listener)
    assert "have 8,000,000 bytes, and parts of each are lost" in found.what
    assert "net.core.rmem_max" in found.cure
