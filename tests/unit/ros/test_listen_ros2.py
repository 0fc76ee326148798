from __future__ import annotations

import contextlib
import os
import socket
import struct
import time
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.errors import NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.ros import listen_ros2
from fleet.ros.quality import Quality
from fleet.ros.rtps_discovery import Endpoint
from tests.support.ros2_peer import Peer, string_message

if TYPE_CHECKING:
    from collections.abc import Iterator

STRING = "=== std_msgs/String\n# what std_msgs/String says\nstring data\n"
NETWORK = """== ssh
127.0.0.1 50000 127.0.0.1 22
== udp
 5563: 00000000:1CE8 00000000:0000 07 00000000:00000000
== igmp
1	lo        :     2      V3
				0100FFEF     1 0:00000000		0
2	eth0      :     2      V3
				0100FFEF     1 0:00000000		0
== containers
/talker-1 host
== end
"""


class OnRobot:
    """What the robot's scripts print."""

    def __init__(self, types: str = STRING, network: str = NETWORK) -> None:
        self.types, self.network, self.asked = types, network, 0

    def __call__(self, argv: tuple[str, ...]) -> str:
        assert argv[:2] == ("sh", "-c")
        if "/proc/net/udp" in argv[2]:
            return self.network
        self.asked += 1
        assert argv[-1] == "std_msgs/String"
        return self.types


@pytest.fixture
def domain() -> int:
    """A domain for each process of a test run: its ports are at 127.0.0.1, where all of them are."""
    return 60 + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]) % 40


@pytest.fixture
def peer(domain: int) -> Iterator[Peer]:
    with Peer(domain=domain).run() as running:
        yield running


def robot(domain: int, **settings: str) -> Robot:
    ros = Ros.model_validate({"version": 2, "domain": domain, **settings})
    return Robot(name="pi1", address="127.0.0.1", ros=ros)


def heard(
    of: Robot, topic: str = "/chatter", *, timeout: float = 5, on_robot: OnRobot | None = None
) -> list[str]:
    """Two messages."""
    arriving = listen_ros2.messages(of, topic, timeout=timeout, on_robot=on_robot or OnRobot())
    with contextlib.closing(arriving):
        return [next(arriving).text(), next(arriving).text()]


def failure(
    of: Robot, topic: str = "/chatter", *, timeout: float = 1.5, on_robot: OnRobot | None = None
) -> RobotError:
    with pytest.raises(RobotError) as caught:
        heard(of, topic, timeout=timeout, on_robot=on_robot)
    assert caught.value.cure
    assert not caught.value.what.endswith(".")
    return caught.value


def test_messages_arrive_in_order(peer: Peer) -> None:
    """As text; the robot is asked once for the definition; at the end the publisher hears that the listener has left."""
    on_robot = OnRobot()
    assert heard(robot(peer.domain), on_robot=on_robot) == ['data: "noon"', 'data: "later"']
    assert on_robot.asked == 1
    end = time.monotonic() + 5
    while not any(b"\x71\0\4\0\0\0\0\3" in datagram for datagram in peer.heard):
        assert time.monotonic() < end
        time.sleep(0.01)


def test_relative_topic_follows_the_robots_namespace(domain: int) -> None:
    """`chatter` is what the robot's own nodes would mean by it."""
    with Peer(domain=domain, topic="/pi1/chatter").run():
        assert heard(robot(domain, namespace="pi1"), "chatter")[0] == 'data: "noon"'


def test_a_large_message(domain: int) -> None:
    """Two megabytes in pieces, as a camera sends them."""
    large = string_message("x" * 2_000_000)
    with Peer(domain=domain, messages=[large] * 20, piece=60_000).run():
        assert all(len(text) == 2_000_008 for text in heard(robot(domain)))


def test_eight_megabytes(domain: int) -> None:
    """A large image: 134 pieces, of which none may be missing."""
    large = string_message("x" * 8_000_000)
    with Peer(domain=domain, messages=[large] * 20, piece=60_000).run():
        assert all(len(text) == 8_000_008 for text in heard(robot(domain), timeout=20))


def test_a_publisher_that_is_restarted(domain: int) -> None:
    """The new one's messages follow, although it is another participant."""
    arriving = listen_ros2.messages(robot(domain), "/chatter", timeout=5, on_robot=OnRobot())
    with contextlib.closing(arriving):
        for text in ("first", "second"):
            with Peer(domain=domain, messages=[string_message(text)] * 5).run():
                assert (
                    next(part for part in (one.text() for one in arriving) if text in part)
                    == f'data: "{text}"'
                )


def test_mistyped_topic(peer: Peer) -> None:
    """A near name is offered."""
    problem = failure(robot(peer.domain), "/chattr")
    assert (problem.what, problem.cure) == ("there is no topic /chattr", "did you mean /chatter?")


def test_nobody_is_there(domain: int) -> None:
    """The robot's own ports tell that its nodes are in another domain."""
    problem = failure(robot(domain), timeout=0.5)
    assert problem.what == f"the nodes of pi1 are in domain 0, and the inventory says {domain}"


def test_participants_that_do_not_answer(domain: int) -> None:
    """They announce themselves, and that is all."""
    with Peer(domain=domain, answers=False).run():
        problem = failure(robot(domain))
    assert isinstance(problem, Unreachable)
    assert "announce themselves" in problem.what


def test_a_publisher_that_ignores_us(domain: int) -> None:
    """Its topic is there, and the subscription is not answered."""
    with Peer(domain=domain, accepts=False).run():
        assert "does not answer the subscription" in failure(robot(domain)).what


def test_a_publisher_that_falls_silent(peer: Peer) -> None:
    """What came is shown, and then the silence is told."""
    arriving = listen_ros2.messages(robot(peer.domain), "/chatter", timeout=1, on_robot=OnRobot())
    assert [next(arriving).text(), next(arriving).text()] == ['data: "noon"', 'data: "later"']
    with pytest.raises(TimedOut, match="/chatter was silent for 1 s"):
        next(arriving)


def test_messages_that_lose_parts(domain: int) -> None:
    """A network that drops each seventh piece lets no large message through."""
    large = string_message("x" * 500_000)
    with Peer(domain=domain, messages=[large] * 50, piece=60_000, lost=7).run():
        problem = failure(robot(domain), timeout=2)
    assert "have 500,009 bytes, and parts of each are lost" in problem.what


@pytest.mark.parametrize(
    ("kind", "types", "reason"),
    [
        ("std_msgs::msg::dds_::String_", "", "no running container of the robot has a definition"),
        (
            "std_msgs::msg::dds_::String_",
            "=== std_msgs/String\nint64 data\n",
            "bytes more than its definition says",
        ),
        ("Cooked", "", "Cooked is not a message type of ROS"),
    ],
)
def test_a_type_that_cannot_be_read(domain: int, kind: str, types: str, reason: str) -> None:
    """One sentence, with the topic."""
    message = b"\0\1\0\0" + struct.pack("<I", 20) + b"x" * 20
    with Peer(domain=domain, kind=kind, messages=[message] * 5).run(), pytest.raises(NotAsPlanned) as caught:
        heard(robot(domain), on_robot=OnRobot(types))
    assert caught.value.what.startswith("/chatter cannot be read: ")
    assert reason in caught.value.what


def test_zenoh_is_refused_at_once(domain: int) -> None:
    """Nothing would ever be heard."""
    began = time.monotonic()
    assert "rmw_zenoh_cpp" in failure(robot(domain, rmw="rmw_zenoh_cpp"), timeout=30).what
    assert time.monotonic() - began < 5


def test_an_address_that_only_ssh_knows(peer: Peer) -> None:
    """The robot says at which address SSH has reached it; if that is no IPv4 address, the cure is an address."""
    alias = robot(peer.domain).model_copy(update={"address": "nobody.invalid"})
    assert heard(alias)[0] == 'data: "noon"'
    six = NETWORK.replace("127.0.0.1 50000 127.0.0.1 22", "fe80::1 50000 fe80::2 22")
    problem = failure(alias, on_robot=OnRobot(network=six))
    assert problem.what == "nobody.invalid has no IPv4 address that this computer knows, and DDS needs one"


def test_hostile_datagrams_do_not_disturb(peer: Peer) -> None:
    """Noise from the network arrives between the messages."""
    arriving = listen_ros2.messages(robot(peer.domain), "/chatter", timeout=5, on_robot=OnRobot())
    peer.messages *= 3
    with contextlib.closing(arriving), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hostile:
        texts = [next(arriving).text()]
        port = next(struct.unpack_from("<I", raw, raw.index(b"\x32\0\x18\0") + 8)[0] for raw in peer.heard)
        for size in range(1, 400):
            hostile.sendto(b"RTPS\2\3\1\x0f" + peer.prefix + os.urandom(size), ("127.0.0.1", port))
        texts += [next(arriving).text() for _ in range(5)]
    assert texts == ['data: "noon"', 'data: "later"'] * 3


def test_multicast_that_does_not_arrive_is_noted_once(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages arrive because the address is known; other computers would find nothing."""
    monkeypatch.setattr(listen_ros2, "HEARD_BY_NOW", 0.2)
    notes: list[str] = []
    peer.messages *= 10
    arriving = listen_ros2.messages(
        robot(peer.domain), "/chatter", timeout=5, on_robot=OnRobot(), on_note=notes.append
    )
    with contextlib.closing(arriving):
        for _ in range(12):
            next(arriving)
    assert len(notes) == 1
    assert "the multicast of pi1 does not" in notes[0]


def test_messages_are_stamped_when_they_arrive(peer: Peer) -> None:
    """Not when they are taken: they wait while the type is asked for, which takes seconds over a slow link."""
    peer.messages *= 5
    on_robot = OnRobot()
    arriving = listen_ros2.messages(robot(peer.domain), "/chatter", timeout=5, on_robot=on_robot)
    with contextlib.closing(arriving):
        next(arriving)
        time.sleep(1)
        woke, woke_monotonic = time.time(), time.monotonic()
        second = next(arriving)
    # It was sent 0.05 s after the first; a computer that does other things may take longer.
    assert second.at < woke - 0.1
    assert second.monotonic < woke_monotonic - 0.1


def test_subscribers_are_judged_when_all_are_known(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another publisher, which would match, may be the next that is found."""
    peer.messages *= 20
    monkeypatch.setattr(listen_ros2, "SETTLED", 0.3)
    with listen_ros2.Listener(robot(peer.domain), "/chatter", ("127.0.0.1",)) as listener:
        asked = Endpoint(
            guid=bytes(16), topic="rt/chatter", type="std_msgs::msg::dds_::Int8_", quality=Quality()
        )
        listener.graph.readers[asked.guid] = asked
        notes: list[str] = []
        began = time.monotonic()
        while not notes:
            assert time.monotonic() - began < 10
            listener.announce(every=0.5)
            for _ in listener.receive():
                pass
            notes = list(listener.notes())
        assert time.monotonic() - began > 0.3
    (note,) = notes
    assert note.startswith(
        "a subscriber of /chatter on pi1 matches no publisher: its type is std_msgs/msg/Int8"
    )
