"""How do people and programs see the messages of a topic? As text, as lines of JSON, or measured."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from fleet.errors import NotAsPlanned
from fleet.ros.measure import OF_THE_CLOCK, Meter
from fleet.ros.message import plain, stamp

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from fleet.rollout.listening import Show
    from fleet.ros.measure import Clocks, Report
    from fleet.ros.message import Message

    Print = Callable[[str, str], None]
    PrintJson = Callable[[Mapping[str, object]], None]


def as_text(printer: Print) -> Show:
    """Return what prints messages as lines after the name of their robot."""

    def show(robot: str, message: Message, _: Clocks | None) -> bool:
        for line in message.text().splitlines():
            printer(robot, line)
        return True

    return show


def as_json(topic: str, printer: PrintJson) -> Show:
    """Return what prints each message as one line of JSON."""

    def show(robot: str, message: Message, _: Clocks | None) -> bool:
        printer({"robot": robot, "topic": topic, "at": message.at, "message": plain(dict(message.read()))})
        return True

    return show


class Measured:
    """Prints reports about the messages of a topic; ``delay``: also how old they are when they arrive."""

    def __init__(
        self, topic: str, *, delay: bool, on_report: Callable[[str, Report, Clocks | None], None]
    ) -> None:
        self._topic, self._delay, self._on_report = topic, delay, on_report
        self._meters: dict[str, Meter] = {}

    def show(self, robot: str, message: Message, clocks: Clocks | None) -> bool:
        """Take in a message. Raises `NotAsPlanned` if it has no stamp and the delay is wanted."""
        meter = self._meters.setdefault(robot, Meter())
        delay = self._age(message, clocks) if self._delay else None
        report = meter.add(at=message.monotonic, size=message.size, delay=delay)
        if report:
            self._on_report(robot, report, clocks)
        return report is not None

    def _age(self, message: Message, clocks: Clocks | None) -> float:
        sent = stamp(message.read())
        if sent is None:
            raise NotAsPlanned(
                f"the messages on {self._topic} have no stamp, so their delay is not known",
                cure="`--rate` measures messages of any type",
            )
        age = message.at + (clocks.ahead if clocks else 0) - sent
        if abs(age) > OF_THE_CLOCK:
            raise NotAsPlanned(
                f"the stamps on {self._topic} are not times of the robot's clock, but {sent:.3f} s: simulated time?",
                cure="`--rate` measures without stamps",
            )
        return age


def report_as_text(printer: Print) -> Callable[[str, Report, Clocks | None], None]:
    """Return what prints a report as one line after the name of its robot."""
    return lambda robot, report, _: printer(robot, str(report))


def report_as_json(topic: str, printer: PrintJson) -> Callable[[str, Report, Clocks | None], None]:
    """Return what prints a report as one line of JSON."""

    def show(robot: str, report: Report, clocks: Clocks | None) -> None:
        compared = {"clock_ahead": clocks and clocks.ahead, "clock_error": clocks and clocks.error}
        printer({"robot": robot, "topic": topic, **asdict(report), **compared})

    return show
