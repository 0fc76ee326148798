from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.cli import heard
from fleet.errors import NotAsPlanned
from fleet.ros.measure import Clocks
from fleet.ros.message import Message

if TYPE_CHECKING:
    from fleet.ros.rosmsg import Value


def message(at: float = 100.0, **values: Value) -> Message:
    return Message(at=at, monotonic=at, size=20, read=lambda: values)


def stamped(at: float, sent: int) -> Message:
    return message(at, header={"stamp": {"sec": sent, "nanosec": 0}})


class Printed:
    """What was printed."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []
        self.values: list[dict[str, object]] = []

    def line(self, robot: str, text: str) -> None:
        self.lines.append((robot, text))

    def json(self, value: object) -> None:
        self.values.append(json.loads(json.dumps(value, allow_nan=False)))


def test_text() -> None:
    """Each line of a message after the name of the robot."""
    printed = Printed()
    assert heard.as_text(printed.line)("pi1", message(x=1, y=2), None)
    assert printed.lines == [("pi1", "x: 1"), ("pi1", "y: 2")]


def test_json() -> None:
    """One object for each message."""
    printed = Printed()
    assert heard.as_json("/time", printed.json)("pi1", message(x=1, y=b"a"), None)
    assert printed.values == [
        {"robot": "pi1", "topic": "/time", "at": 100.0, "message": {"x": 1, "y": "YQ=="}}
    ]


def test_rates_need_no_type() -> None:
    """Messages that cannot be read are counted; each robot for itself, and while its clock is set back."""

    def unreadable() -> dict[str, Value]:
        raise NotAsPlanned("cannot be read")

    printed = Printed()
    show = heard.Measured("/time", delay=False, on_report=heard.report_as_text(printed.line)).show
    shown = [
        show(robot, Message(at=7 - at, monotonic=at, size=20, read=unreadable), None)
        for at in (1.0, 1.5, 2.0)
        for robot in ("pi1", "pi2")
    ]
    assert shown == [False, False, False, False, True, True]
    assert printed.lines == [(name, "2 messages/s, 500 to 500 ms apart, 40 B/s") for name in ("pi1", "pi2")]


def test_delays_are_by_the_robots_clock() -> None:
    """It is 5 seconds ahead: a message that seems to come from the future is half a second old."""
    printed = Printed()
    show = heard.Measured("/time", delay=True, on_report=heard.report_as_json("/time", printed.json)).show
    for second in range(2):
        show("pi1", stamped(100.5 + second, 105 + second), Clocks(ahead=5.0, error=0.1))
    (report,) = printed.values
    assert (report["delay"], report["clock_ahead"], report["clock_error"]) == (0.5, 5.0, 0.1)
    show = heard.Measured("/time", delay=True, on_report=heard.report_as_text(printed.line)).show
    for second in range(2):
        show("pi1", stamped(100.5 + second, 100 + second), None)
    assert printed.lines[0][1].endswith("delay 500 ms (500 to 500 ms)")


@pytest.mark.parametrize(
    ("values", "reason"),
    [({"data": "noon"}, "have no stamp"), ({"stamp": {"sec": 3, "nanosec": 0}}, "simulated time?")],
)
def test_messages_without_a_delay(values: dict[str, Value], reason: str) -> None:
    """That is said at the first of them, with what can be measured."""
    show = heard.Measured("/x", delay=True, on_report=lambda *_: None).show
    with pytest.raises(NotAsPlanned, match=reason) as caught:
        show("pi1", message(1.8e9, **values), None)
    assert "--rate" in caught.value.cure
