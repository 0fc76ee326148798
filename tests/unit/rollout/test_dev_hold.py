from __future__ import annotations

import threading
from typing import TYPE_CHECKING, cast

import pytest

from fleet.errors import CommandFailed, LinkLost
from fleet.plan.watch import GONE, Change, State
from fleet.rollout.dev_hold import Hold
from fleet.ssh.session import Result, Session

if TYPE_CHECKING:
    from collections.abc import Callable

GOOD = (
    b"has node abc.644 /app/a file\nhas node - /app/b\nhas \npart 0a1b 5\npart x y\nready 2026-11-28T12:00:00Z\n"
    b"said node one line\nstates node,running,0,0,healthy \nnonsense\n"
)


class Robot:
    """A connection whose command prints something, and ends when it is told."""

    def __init__(self, output: bytes, result: Result | Exception) -> None:
        self._output = output
        self._result = result
        self.go = threading.Event()

    def run(self, _argv: tuple[str, ...], *, on_output: Callable[[bytes], None], **_: object) -> Result:
        for start in range(0, len(self._output), 7):
            on_output(self._output[start : start + 7])
        self.go.wait(10)
        if isinstance(self._result, Exception):
            raise self._result
        return self._result


def hold(robot: Robot) -> Hold:
    return Hold(cast("Session", robot), ("hold",), changed=threading.Condition())


def wait_for(condition: Callable[[], bool], changed: threading.Condition) -> None:
    with changed:
        assert changed.wait_for(condition, timeout=10)


def test_what_a_robot_says() -> None:
    """Lines are read as they come; words that nobody knows are passed over. Then somebody ends dev."""
    robot = Robot(GOOD, Result(code=0, output="", errors=""))
    changed = threading.Condition()
    one = Hold(cast("Session", robot), ("hold",), changed=changed)
    one.start()
    wait_for(lambda: bool(one.states), changed)
    assert one.has == {("node", "/app/a file"): "abc.644", ("node", "/app/b"): GONE}
    assert one.parts == {"0a1b": 5}
    assert one.said == [("node", "one line")]
    assert one.states == (State(service="node", state="running", health="healthy"),)
    assert not one.over
    robot.go.set()
    wait_for(lambda: one.over, changed)
    assert one.end() == ""


def test_who_has_ended_it() -> None:
    """The last line of the history."""
    robot = Robot(b"ready x\nended 2026 ship abc ada@laptop done\n", Result(code=0, output="", errors=""))
    robot.go.set()
    one = hold(robot)
    one.start()
    while not one.over:
        pass
    assert one.end() == "2026 ship abc ada@laptop done"


@pytest.mark.parametrize(
    ("result", "error", "text"),
    [
        (
            Result(code=75, output="", errors="tim@desktop has `fab dev` on this robot\n"),
            CommandFailed,
            "tim@desktop has",
        ),
        (LinkLost("the connection was lost"), LinkLost, "was lost"),
    ],
)
def test_why_it_does_not_begin(result: Result | Exception, error: type[Exception], text: str) -> None:
    """In the thread that waits for it."""
    robot = Robot(b"", result)
    robot.go.set()
    one = hold(robot)
    with pytest.raises(error, match=text):
        one.start()
    with pytest.raises(error, match=text):
        one.end()


def test_what_is_about_to_change_is_unknown() -> None:
    """If the sync fails in the middle, it is done again."""
    one = hold(Robot(b"", LinkLost("x")))
    change = Change(verb="put", service="node", digest="1", place="/app/a")
    one.remember((change,))
    assert one.has == {("node", "/app/a"): "1"}
    one.forget((change,))
    assert one.has == {}
