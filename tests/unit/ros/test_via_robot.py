from __future__ import annotations

import base64
import contextlib
import json
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.errors import NotAsPlanned, NotReady, RobotError
from fleet.ros import via_robot
from fleet.ros.via_robot import Heard

if TYPE_CHECKING:
    from fleet.ros.message import Message

ROBOT = Robot(name="pi1", address="10.0.0.2", ros=Ros(version=2))


class Ear:
    """What was heard."""

    def __init__(self) -> None:
        self.messages: list[Message] = []
        self.containers: list[str] = []
        self.heard = Heard(
            read=lambda kind, definition, data: {"type": kind, "definition": definition, "data": data},
            on_message=self.messages.append,
            on_container=self.containers.append,
        )


def line(data: bytes = b"noon", **more: object) -> bytes:
    said = {"type": "T", "at": 7.5, "monotonic": 3.5, "data": base64.b64encode(data).decode(), **more}
    return json.dumps(said).encode() + b"\n"


def test_the_command() -> None:
    """The program of the robot's ROS, as one argument of the script; before it, the variable of containers that come first."""
    shared = Ros(master="http://base:11311")
    for ros, part, variable in (
        (shared, "TCPROS", "ROS_MASTER_URI=http://base:11311"),
        (Ros(), "TCPROS", "ROS_MASTER_URI=http://localhost:11311"),
        (Ros(version=2, domain=7), "rclpy", "ROS_DOMAIN_ID=7"),
    ):
        robot = ROBOT.model_copy(update={"ros": ros})
        argv = via_robot.command(robot, "/time", timeout=10)
        assert argv[:2] == ("sh", "-c")
        assert argv[4] == variable
        assert part in argv[5]
        assert argv[6:] == ("/time", "--timeout", "10", "--all")


@given(st.lists(st.integers(1, 40), max_size=40), st.binary(max_size=300))
def test_lines_in_any_pieces(sizes: list[int], data: bytes) -> None:
    """However the bytes arrive, the messages are the same; the container is told once, with the first message."""
    whole = b"== clock-talker-1\n" + line(data) + line(b"later", definition="string data")
    ear, at = Ear(), 0
    for size in (*sizes, len(whole)):
        ear.heard.on_output(whole[at : at + size])
        at += size
    assert [(one.at, one.monotonic, one.size, one.read()["data"]) for one in ear.messages] == [
        (7.5, 3.5, len(data), data),
        (7.5, 3.5, 5, b"later"),
    ]
    assert ear.messages[1].read()["definition"] == "string data"
    assert ear.containers == ["clock-talker-1"]


@given(st.lists(st.binary(max_size=60) | st.just(b"\n") | st.just(line())))
def test_whatever_the_robot_prints(pieces: list[bytes]) -> None:
    """A message, a reason, or one sentence."""
    ear = Ear()
    with contextlib.suppress(NotAsPlanned):
        for piece in pieces:
            ear.heard.on_output(piece)


@pytest.mark.parametrize(
    "said",
    [
        b"{}",
        line(at=float("nan")).strip(),
        b'{"type": "T", "at": 1e999, "monotonic": 1, "data": ""}',
        b'{"type": "T", "at": 1, "monotonic": -1e999, "data": ""}',
        b'{"type": "T", "monotonic": 1, "data": "", "at": 1' + b"0" * 400 + b"}",
        b'{"type": "T", "at": 1, "data": "", "monotonic": 1' + b"0" * 400 + b"}",
        b'{"type": "T", "at": 1, "data": "", "monotonic": 1' + b"0" * 9000 + b"}",
        b'{"type": 1}',
        b'{"type": "T", "at": 1, "monotonic": 1, "data": "?"}',
        b'{"a"',
        b"{" * 5000,
        b'{"at": {}, "data": ""}',
    ],
)
def test_lines_that_are_no_messages(said: bytes) -> None:
    """One sentence, that shows the beginning."""
    with pytest.raises(NotAsPlanned, match="not a message"):
        Ear().heard.on_output(said + b"\n")


def test_a_line_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not collected for ever."""
    monkeypatch.setattr(via_robot, "LARGEST_LINE", 1000)
    ear = Ear()
    ear.heard.on_output(b"x" * 1000)
    with pytest.raises(NotAsPlanned, match="a line of more than"):
        ear.heard.on_output(b"x")


def test_eight_megabytes() -> None:
    """In the pieces in which SSH gives them."""
    ear, whole = Ear(), line(b"x" * 8_000_000)
    for at in range(0, len(whole), 32_768):
        ear.heard.on_output(whole[at : at + 32_768])
    assert ear.messages[0].size == 8_000_000


def failure(output: bytes, *, code: int, errors: str = "", robot: Robot = ROBOT) -> RobotError:
    ear = Ear()
    ear.heard.on_output(output)
    found = ear.heard.failure(robot, "/time", code=code, errors=errors)
    assert found.cure
    return found


def test_reasons() -> None:
    """Where it was listened, and what the program says; or why nobody could listen."""
    said = failure(b"== clock-talker-1\n/time: nobody publishes it\n", code=1)
    assert (
        said.what == "/time is not heard on pi1 itself, in the container clock-talker-1: nobody publishes it"
    )
    tried = b"== wrong\n/time: no way\n== clock-talker-1\n/time: nobody publishes it\n== other\n/time: x\n== clock-talker-1\n"
    assert failure(tried, code=4).what == said.what
    for ros, lacks in ((Ros(version=2), "rclpy"), (Ros(), "Python 3")):
        said = failure(b"", code=3, robot=ROBOT.model_copy(update={"ros": ros}))
        assert isinstance(said, NotReady)
        assert said.what == f"no container of pi1 can listen: none has {lacks}"
    said = failure(b"== a\n/time: no connection to localhost port 11311\n== a\n", code=3)
    assert said.what == "no container of pi1 can listen: no connection to localhost port 11311"
    said = failure(b"", code=1, errors="permission denied while trying to connect")
    assert said.what == "the containers of pi1 cannot be asked: permission denied while trying to connect"
    assert "code 137" in failure(b"== a\n", code=137).what


def test_a_robot_that_names_containers_without_end() -> None:
    """What is kept of them has a limit."""
    ear = Ear()
    for number in range(3000):
        ear.heard.on_output(b"== " + str(number).encode() * 2000 + b"\nno\n")
    kept = ear.heard._reasons  # noqa: SLF001
    assert len(kept) == via_robot.MOST_CONTAINERS
    assert max(map(len, kept)) == via_robot.LONGEST_NAME
