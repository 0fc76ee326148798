"""How are logs and command output of many robots shown line by line as they arrive?

Each robot has a thread; all lines go to one printer. Ctrl-C ends the stream and is not a failure.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import CommandFailed
from fleet.plan.outcome import Outcome
from fleet.rollout.pool import each

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress

    Printer = Callable[[str, str], None]


LONGEST_LINE = 64 * 1024
"""Bytes of a line that are shown as one: a robot may print for ever without an end of line."""


class Lines:
    """Split bytes, as they arrive, into whole lines. Of a line that is too long each part becomes a line."""

    def __init__(self, on_line: Callable[[str], None]) -> None:
        self._on_line = on_line
        self._rest = b""

    def on_output(self, data: bytes) -> None:
        """Take the next bytes of output."""
        *lines, rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._show(line)
        if whole := max(len(rest) - 1, 0) // LONGEST_LINE * LONGEST_LINE:
            self._show(rest[:whole])
        self._rest = rest[whole:]

    def _show(self, line: bytes) -> None:
        for start in range(0, max(len(line), 1), LONGEST_LINE):
            self._on_line(line[start : start + LONGEST_LINE].decode(errors="replace").rstrip("\r"))

    def end(self) -> None:
        """Pass on a last line that has no line end."""
        if self._rest:
            self.on_output(b"\n")


def logs(
    robots: Sequence[Robot],
    argv_of: Callable[[Robot, Facts], tuple[str, ...]],
    *,
    follow: bool,
    printer: Printer,
    progress: Progress,
) -> tuple[Outcome, ...]:
    """Print the logs of each robot's containers, and with ``follow`` also new lines as they come."""

    def work(link: Link) -> Outcome:
        argv = argv_of(link.robot, link.facts())
        feed = None if follow else ()
        return _stream(link, argv, printer, feed=feed, limit=None if follow else 60.0)

    return each(robots, work, progress=progress)


def run(
    robots: Sequence[Robot], command: str, *, limit: float, printer: Printer, progress: Progress
) -> tuple[Outcome, ...]:
    """Run a shell command on each robot. ``limit`` is in seconds, 0 for none."""

    def work(link: Link) -> Outcome:
        return _stream(link, ("sh", "-c", command), printer, feed=(), limit=limit or None)

    return each(robots, work, progress=progress)


def _stream(
    link: Link, argv: tuple[str, ...], printer: Printer, *, feed: tuple[()] | None, limit: float | None
) -> Outcome:
    name = link.robot.name
    output, errors = (Lines(lambda text: printer(name, text)) for _ in range(2))
    result = link.session.run(
        argv, feed=feed, limit=limit, on_output=output.on_output, on_errors=errors.on_output
    )
    output.end()
    errors.end()
    if result.code:
        raise CommandFailed(f"ended with code {result.code}", code=result.code)
    return Outcome(robot=name, status="done")
