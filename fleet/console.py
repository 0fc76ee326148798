"""What does the person see? Tables, live progress, plain lines when piped, JSON for programs.

The only module that imports rich. Results go to standard output; progress and problems to standard error.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import threading
from collections import Counter
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, DownloadColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.progress import TimeRemainingColumn, TransferSpeedColumn
from rich.table import Table
from rich.text import Text

from fleet.plan import human_bytes, human_seconds, lines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from types import TracebackType

    from rich.progress import TaskID

    from fleet.plan import Outcome, Plan

_MARKS = {
    "done": "green",
    "unchanged": "dim",
    "failed": "bold red",
    "unreachable": "bold yellow",
    "skipped": "yellow",
}
_COLOURS = ("cyan", "magenta", "green", "yellow", "blue", "bright_red", "bright_cyan", "bright_magenta")
_COLUMNS_OF_A_FILE = 200
"""Width of lines that do not go to a terminal: long enough that no table is folded."""


class Screen:
    """The terminal, or what stands in for it."""

    def __init__(self) -> None:
        width = None if sys.stdout.isatty() else _COLUMNS_OF_A_FILE
        self.out = Console(width=width, highlight=False, soft_wrap=not sys.stdout.isatty())
        self.err = Console(
            stderr=True, width=None if sys.stderr.isatty() else _COLUMNS_OF_A_FILE, highlight=False
        )

    def say(self, text: str) -> None:
        """One line of what is going on."""
        self.err.print(Text(text))

    def line(self, text: str) -> None:
        """One line of result, exactly."""
        self.out.print(Text(text), soft_wrap=True)

    def json(self, value: object) -> None:
        """A value for programs, on standard output."""
        sys.stdout.write(json.dumps(_plain(value), indent=2, ensure_ascii=False) + "\n")

    def plans(self, plans: Iterable[Plan]) -> None:
        """What ``--dry`` shows."""
        for plan in plans:
            for number, text in enumerate(lines(plan)):
                self.out.print(Text(text, style="bold" if number == 0 else ""), soft_wrap=True)

    def outcomes(self, outcomes: Sequence[Outcome]) -> None:
        """A line per robot, its reason and cure below where it has one, and the sum."""
        width = max((len(outcome.robot) for outcome in outcomes), default=0)
        for outcome in outcomes:
            text = Text.assemble(
                f"{outcome.robot:{width}}  ",
                (f"{outcome.status:11}", _MARKS[outcome.status]),
                f"  {_told(outcome)}",
            )
            self.out.print(text, soft_wrap=True)
            for detail in _details(outcome):
                self.out.print(Text(f"{'':{width}}  {detail}"), soft_wrap=True)
        counted = Counter(outcome.status for outcome in outcomes)
        self.say(", ".join(f"{counted[status]} {status}" for status in _MARKS if counted[status]))

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[tuple[str, str]]]) -> None:
        """A table of cells, each a text and a style."""
        self.out.print(_table(columns, rows))

    def live(
        self,
        columns: Sequence[str],
        rows: Callable[[], list[Sequence[tuple[str, str]]]],
        wait: Callable[[], None],
    ) -> None:
        """A table that is drawn again and again until Ctrl-C; ``wait`` passes the time in between."""
        with Live(_table(columns, rows()), console=self.out, screen=False, auto_refresh=False) as live:
            while True:
                wait()
                live.update(_table(columns, rows()), refresh=True)

    def prefixed(self, names: Sequence[str]) -> Callable[[str, str], None]:
        """A printer of lines with a coloured name before each, safe to call from many threads."""
        width = max((len(name) for name in names), default=0)
        styles = {name: _COLOURS[number % len(_COLOURS)] for number, name in enumerate(names)}
        lock = threading.Lock()

        def printer(name: str, text: str) -> None:
            with lock:
                self.out.print(Text.assemble((f"{name:{width}} | ", styles[name]), text), soft_wrap=True)

        return printer

    def progress(self) -> Show:
        """Live progress on a terminal, a line per step where there is none."""
        return Bars(self.err) if self.err.is_terminal else Lines(self)


class Lines:
    """Progress where nobody watches live: one line when a robot starts something."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def began(self, robot: str, title: str, size: int | None) -> None:
        """See `fleet.rollout.Watch`."""
        self._screen.say(f"{robot}: {title}" + (f" ({human_bytes(size)})" if size else ""))

    def sent(self, robot: str, count: int) -> None:
        """See `fleet.rollout.Watch`."""

    def ended(self, outcome: Outcome) -> None:
        """See `fleet.rollout.Watch`."""
        self._screen.say(f"{outcome.robot}: {outcome.status} after {human_seconds(outcome.seconds)}")


class Bars:
    """A line per robot that moves: what it does, and where bytes flow how many, how fast and how long still."""

    def __init__(self, console: Console) -> None:
        self._moving = Progress(
            SpinnerColumn(),
            TextColumn("[bold]{task.fields[robot]}"),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            DownloadColumn(),
            TransferSpeedColumn(),
            TimeRemainingColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._tasks: dict[str, TaskID] = {}
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        self._moving.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._moving.stop()

    def began(self, robot: str, title: str, size: int | None) -> None:
        """See `fleet.rollout.Watch`."""
        with self._lock:
            if old := self._tasks.pop(robot, None):
                self._moving.remove_task(old)
            self._tasks[robot] = self._moving.add_task(title, total=size, robot=robot)

    def sent(self, robot: str, count: int) -> None:
        """See `fleet.rollout.Watch`."""
        self._moving.advance(self._tasks[robot], count)

    def ended(self, outcome: Outcome) -> None:
        """See `fleet.rollout.Watch`."""
        with self._lock:
            if task := self._tasks.pop(outcome.robot, None):
                self._moving.remove_task(task)


Show = Lines | Bars


def _table(columns: Sequence[str], rows: Iterable[Sequence[tuple[str, str]]]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(Text(text, style=style) for text, style in row))
    return table


def _told(outcome: Outcome) -> str:
    if outcome.good:
        took = f", {human_seconds(outcome.seconds)}" if outcome.status == "done" else ""
        sent = f", sent {human_bytes(outcome.sent)}" if outcome.sent else ""
        return f"{outcome.summary}{sent}{took}"
    first = outcome.reason.splitlines()[0] if outcome.reason else ""
    return f"{outcome.step}: {first}" if outcome.step else first


def _details(outcome: Outcome) -> list[str]:
    """What is told below the robot's line: the rest of the reason (log lines), then the cure."""
    if outcome.good:
        return []
    details = [f"  | {line}" for line in outcome.reason.splitlines()[1:]]
    return [*details, f"  cure: {outcome.cure}"] if outcome.cure else details


def _plain(value: object) -> object:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    return value if isinstance(value, str | int | float | bool | None) else str(value)
