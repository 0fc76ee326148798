"""What do many robots say, line by line, as it comes? Logs, the output of commands, the messages of a topic.

Each robot has a thread; all lines go to one printer. Ctrl-C ends the listening and is not a failure.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

from fleet.errors import CommandFailed
from fleet.plan.outcome import Outcome
from fleet.rollout.pool import each
from fleet.ros import listen

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress

    Printer = Callable[[str, str], None]


class Lines:
    """Bytes as they arrive, handed on as whole lines."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._rest = b""

    def heard(self, data: bytes) -> None:
        """Take a piece of output."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._tell(line.decode(errors="replace").rstrip("\r"))

    def end(self) -> None:
        """Hand on a last line that has no end."""
        if self._rest:
            self.heard(b"\n")


def logs(
    robots: Sequence[Robot],
    argv_of: Callable[[Robot, Facts], tuple[str, ...]],
    *,
    follow: bool,
    printer: Printer,
    watch: Progress,
) -> tuple[Outcome, ...]:
    """Print what each robot's containers said, and with ``follow`` what they say from now on."""

    def work(line: Link) -> Outcome:
        argv = argv_of(line.robot, line.facts())
        feed = None if follow else ()
        return _stream(line, argv, printer, feed=feed, limit=None if follow else 60.0)

    return each(robots, work, watch=watch)


def run(
    robots: Sequence[Robot], command: str, *, limit: float, printer: Printer, watch: Progress
) -> tuple[Outcome, ...]:
    """Run a line of shell on each robot; ``limit`` in seconds, 0 for none."""

    def work(line: Link) -> Outcome:
        return _stream(line, ("sh", "-c", command), printer, feed=(), limit=limit or None)

    return each(robots, work, watch=watch)


def topics(
    robots: Sequence[Robot], topic: str, *, count: int, timeout: float, printer: Printer, watch: Progress
) -> tuple[Outcome, ...]:
    """Print a topic's messages from each robot: ``count`` of them, or without end for 0; silence in seconds."""

    def work(line: Link) -> Outcome:
        heard = 0
        for text in islice(listen.messages(line.robot, topic, timeout=timeout), count or None):
            heard += 1
            for part in text.splitlines():
                printer(line.robot.name, part)
        return Outcome(robot=line.robot.name, status="done", summary=f"heard {heard} messages on {topic}")

    return each(robots, work, watch=watch, at_once=len(robots))


def _stream(
    line: Link, argv: tuple[str, ...], printer: Printer, *, feed: tuple[()] | None, limit: float | None
) -> Outcome:
    name = line.robot.name
    lines = Lines(lambda text: printer(name, text))
    result = line.session.run(argv, feed=feed, limit=limit, heard=lines.heard)
    lines.end()
    for text in result.errors.splitlines():
        printer(name, text)
    if result.code:
        raise CommandFailed(f"ended with code {result.code}", code=result.code, output=result.errors)
    return Outcome(robot=name, status="done")
