from __future__ import annotations

import json
import os
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.rollout import listening
from fleet.rollout.listening import Request
from fleet.ros import cdr, listen, listen_ros2, rosmsg
from tests.support.homes import Told, start
from tests.support.ros2_peer import Peer
from tests.support.ros_peers import Peers, string_message

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from fleet.plan.outcome import Outcome
    from fleet.ros.measure import Clocks
    from fleet.ros.message import Message
    from tests.support.sshd import Sshds

DOMAIN = 59 - int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])


class Heard:
    """What was shown and noted."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.clocks: Clocks | None = None
        self.notes: list[str] = []

    def show(self, robot: str, message: Message, clocks: Clocks | None) -> bool:
        assert robot == "pi1"
        self.texts.append(message.text())
        self.clocks = clocks
        return True

    def note(self, robot: str, text: str) -> None:
        assert robot == "pi1"
        self.notes.append(text)


def hear(
    robot: Robot, heard: Heard, *, topic: str = "/time", count: int = 0, timeout: float = 5, via_robot: bool = False,
    clocks: bool = False,
) -> Outcome:  # fmt: skip
    request = Request(topic=topic, count=count, timeout=timeout, via_robot=via_robot, clocks=clocks)
    (outcome,) = listening.hear([robot], request, show=heard.show, notes=heard.note, progress=Told())
    return outcome


@pytest.fixture
def talker() -> Iterator[Robot]:
    peers = Peers(messages=(string_message("one"), string_message("two\nlines"), string_message("three")))
    with peers.run():
        yield Robot(name="pi1", address="127.0.0.1", ros=Ros(master=peers.master))


def test_so_many_messages_of_a_topic(talker: Robot) -> None:
    """It ends when all are there."""
    heard = Heard()
    outcome = hear(talker, heard, count=2)
    assert (outcome.status, outcome.summary) == ("done", "received 2 messages on /time")
    assert heard.texts == ['data: "one"', 'data: "two\\nlines"']


def test_a_topic_that_falls_silent(talker: Robot) -> None:
    """What came is shown, and the silence is this robot's failure."""
    heard = Heard()
    outcome = hear(talker, heard, timeout=0.5)
    assert outcome.status == "failed"
    assert "silent for 0.5 s" in outcome.reason
    assert heard.texts[-1] == 'data: "three"'


def docker_of(sshds: Sshds, text: str) -> None:
    docker = sshds.folder / "identity of pi1/docker"
    docker.write_text(f"#!/bin/sh\n{text}\n")
    docker.chmod(0o755)


@pytest.fixture
def definition(sshds: Sshds) -> Path:
    """The folder of a ROS that has the definition of std_msgs/String."""
    found = sshds.folder / "ros/share/std_msgs/msg/String.msg"
    found.parent.mkdir(parents=True)
    found.write_text("string data\n")
    return sshds.folder / "ros"


def test_messages_of_a_robot_with_ros_2(sshds: Sshds, definition: Path) -> None:
    """They come over the network, and the definition of their type over SSH, out of the robot's container."""
    home = start(sshds, "pi1")
    docker_of(
        sshds, f'[ "$1" = exec ] || exec echo container\nshift 2; AMENT_PREFIX_PATH="{definition}" exec "$@"'
    )
    robot = home.robot.model_copy(update={"ros": Ros(version=2, domain=DOMAIN)})
    heard = Heard()
    with Peer(domain=DOMAIN).run():
        outcome = hear(robot, heard, topic="/chatter", count=2)
    assert (outcome.status, heard.texts) == ("done", ['data: "noon"', 'data: "later"'])
    outcome = hear(robot, heard, topic="/chatter", count=1, timeout=0.5)
    assert outcome.status in ("failed", "unreachable")
    assert outcome.cure


def test_clocks_are_compared(sshds: Sshds, talker: Robot) -> None:
    """Before the first message; this computer's own clock does not differ from itself by more than the question took."""
    home = start(sshds, "pi1")
    heard = Heard()
    robot = home.robot.model_copy(update={"ros": talker.ros})
    assert hear(robot, heard, count=1, clocks=True).status == "done"
    assert heard.clocks
    assert abs(heard.clocks.ahead) <= heard.clocks.error < 5
    assert heard.notes == [str(heard.clocks)]
    (sshds.folder / "identity of pi1/date").write_text("#!/bin/sh\necho 1795829162.%N\n")
    (sshds.folder / "identity of pi1/date").chmod(0o755)
    outcome = hear(robot, heard, count=1, clocks=True)
    assert "its clock cannot be compared" in outcome.reason
    assert "--via robot" in outcome.cure


@pytest.mark.parametrize("version", [1, 2])
def test_via_the_robot(sshds: Sshds, definition: Path, version: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages come through SSH, out of a container, and that is told; at the end, nothing is left running.

    The definition of their type is read once.
    """
    parsed: list[str] = []

    def parse(kind: str, text: str) -> dict[str, tuple[rosmsg.Field, ...]]:
        parsed.append(kind)
        return dict(reading.parse(kind, text))

    reading = rosmsg if version == 1 else cdr
    monkeypatch.setattr(
        listen if version == 1 else listen_ros2,
        "rosmsg" if version == 1 else "cdr",
        SimpleNamespace(**{**vars(reading), "parse": parse}),
    )
    home = start(sshds, "pi1")
    line = {"type": "std_msgs/msg/String", "at": 7.5, "monotonic": 1.5, "data": "AAEAAAUAAABub29uAA=="}
    if version == 1:
        line = {
            "type": "std_msgs/String",
            "definition": "string data",
            "at": 7.5,
            "monotonic": 1.5,
            "data": "BAAAAG5vb24=",
        }
    (sshds.folder / "line").write_text(json.dumps(line) + "\n")
    docker_of(
        sshds,
        f"""case $1 in ps) echo a; exit ;; inspect) echo '== clock-1'; exit ;; esac
[ "$2" = --interactive ] || case "$*" in *'import sys'*) exit 0 ;; *) shift 2; AMENT_PREFIX_PATH={definition} exec "$@" ;; esac
while :; do cat {sshds.folder}/line; sleep 0.05 || exit; [ -e {sshds.folder}/ended ] && break; done""",
    )
    robot = home.robot.model_copy(update={"ros": Ros(version=version)})
    heard = Heard()
    outcome = hear(robot, heard, topic="time", count=3, via_robot=True)
    (sshds.folder / "ended").touch()
    assert (outcome.status, outcome.summary) == ("done", "received 3 messages on time")
    assert heard.texts == ['data: "noon"'] * 3
    assert len(parsed) == 1
    assert len(heard.notes) == 1
    assert heard.notes[0].startswith(
        "heard on the robot itself, in the container clock-1, and not over the network"
    )


def test_via_a_robot_that_cannot(sshds: Sshds) -> None:
    """Without containers, with the cure."""
    home = start(sshds, "pi1")
    docker_of(sshds, "exit 0")
    robot = home.robot.model_copy(update={"ros": Ros(version=2)})
    outcome = hear(robot, Heard(), via_robot=True)
    assert (outcome.status, outcome.reason) == (
        "failed",
        "no container of pi1 can listen: none is running",
    )
