"""What does a person see? Tables, live progress, plain lines when piped, JSON for programs.

The only module that imports rich. Results go to standard output; progress and problems to standard error.
"""

from __future__ import annotations

import sys
import threading
from collections import Counter
from typing import TYPE_CHECKING, Self

from rich.cells import cell_len
from rich.console import Console
from rich.live import Live
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.table import Table
from rich.text import Text

from fleet import terminal
from fleet.cli import json_output, program
from fleet.cli.growing_table import GrowingTable
from fleet.plan.describe import details, headline, lines
from fleet.plan.outcome import exit_code
from fleet.units import human_bytes, human_seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from types import TracebackType

    from rich.console import RenderableType
    from rich.progress import Task, TaskID

    from fleet.images.image import Image
    from fleet.plan.outcome import Outcome
    from fleet.plan.step import Plan

_MARKS = {
    "done": "green",
    "unchanged": "dim",
    "planned": "cyan",
    "failed": "bold red",
    "unreachable": "bold yellow",
    "skipped": "yellow",
}
_COLOURS = ("cyan", "magenta", "green", "yellow", "blue", "bright_red", "bright_cyan", "bright_magenta")
_WIDEST = 60
"""Columns of a cell that later rows are aligned with."""

_LONGEST_CELL = 2000
"""Characters of a cell that are shown."""

_COLUMNS_OF_A_FILE = 10_000
"""Width of lines that do not go to a terminal: no table is folded there."""


class Terminal(Console):
    """Rich's console, which raises an exception if the reader is gone (``| head``), instead of ending the program."""

    def on_broken_pipe(self) -> None:
        """See ``rich.console.Console.on_broken_pipe``."""
        raise BrokenPipeError


class Screen:
    """The terminal, or the file or pipe in its place."""

    def __init__(self) -> None:
        width = None if sys.stdout.isatty() else _COLUMNS_OF_A_FILE
        self.out = Terminal(width=width, highlight=False, soft_wrap=not sys.stdout.isatty())
        self.err = Terminal(
            stderr=True, width=None if sys.stderr.isatty() else _COLUMNS_OF_A_FILE, highlight=False
        )
        self._lines = threading.Lock()

    def say(self, text: str) -> None:
        """Print one line of progress."""
        self.err.print(_text(text))

    def warnings(self, by_robot: Mapping[str, Sequence[str]]) -> None:
        """Print warnings about robots' stacks, each once, with the robots that it is about."""
        about: dict[str, list[str]] = {}
        for name, texts in by_robot.items():
            for text in texts:
                about.setdefault(text, []).append(name)
        for text, names in about.items():
            who = ", ".join(names) if len(names) < 5 else f"{len(names)} robots"
            self.say(f"{who}: {text}")

    def lines(self, lines: Iterable[str]) -> None:
        """Print lines of the result unchanged."""
        for line in lines:
            self.out.print(_text(line), soft_wrap=True)

    def json(self, value: object) -> None:
        """Print a value for programs on standard output."""
        sys.stdout.write(json_output.text(value) + "\n")

    def json_line(self, value: object) -> None:
        """Print one of many values for programs, at once. Many threads may call it."""
        with self._lines:
            sys.stdout.write(json_output.line(value) + "\n")
            sys.stdout.flush()

    def plans(self, plans: Iterable[Plan]) -> None:
        """Print plans, for ``--dry``."""
        for plan in plans:
            for number, text in enumerate(lines(plan)):
                self.out.print(_text(text, "bold" if number == 0 else ""), soft_wrap=True)

    def images(self, images: Iterable[Image], *, json: bool) -> None:
        """Print the name, platform and size of local images."""
        if json:
            self.json(list(images))
        else:
            columns = ("image", "platform", "size")
            self.table(
                columns, [((i.reference, ""), (i.platform, ""), (human_bytes(i.size), "")) for i in images]
            )

    def outcomes(self, outcomes: Sequence[Outcome]) -> None:
        """Print a line per robot, the reason and cure of a failure below it, and the totals."""
        width = max((len(outcome.robot) for outcome in outcomes), default=0)
        for outcome in outcomes:
            text = Text.assemble(
                f"{outcome.robot:{width}}  ",
                (f"{outcome.status:11}", _MARKS[outcome.status]),
                f"  {terminal.plain(headline(outcome))}",
            )
            self.out.print(text, soft_wrap=True)
            for detail in details(outcome):
                self.out.print(_text(program.typed(f"{'':{width}}  {detail}")), soft_wrap=True)
        counted: Counter[str] = Counter(outcome.status for outcome in outcomes)
        self.say(", ".join(f"{counted[status]} {status}" for status in _MARKS if counted[status]))

    def problems(self, outcomes: Sequence[Outcome]) -> int:
        """Print the robots that failed on standard error, and return the exit code. Ctrl-C is not a failure here."""
        bad = [outcome for outcome in outcomes if not outcome.good and outcome.status != "skipped"]
        for outcome in bad:
            for text in (f"{outcome.robot}: {headline(outcome)}", *details(outcome)):
                self.err.print(_text(program.typed(text)), soft_wrap=True)
        return exit_code(tuple(bad))

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[tuple[str, str]]]) -> None:
        """Print a table of cells, each a text and a style."""
        self.out.print(_table(columns, rows))

    def live(self, columns: Sequence[str], rows: Callable[[], Sequence[Sequence[tuple[str, str]]]]) -> Live:
        """Return a table that is drawn again every half second until its ``with`` block ends."""
        return Live(get_renderable=lambda: _table(columns, rows()), console=self.out, refresh_per_second=2)

    def growing(
        self, columns: Sequence[str], rows: Callable[[], Sequence[Sequence[tuple[str, str]]]]
    ) -> Live | GrowingTable:
        """Return a table whose rows appear as ``rows`` has more of them at its end, until its ``with`` block ends."""
        if self.out.is_terminal:
            return self.live(columns, rows)
        widths = [0] * len(columns)

        def show(more: Sequence[Sequence[tuple[str, str]]], first: bool) -> None:
            for place, width in enumerate(widths):
                cells = [min(cell_len(terminal.plain(row[place][0])), _WIDEST) for row in more]
                widths[place] = max(width, *cells, 0)
            self.out.print(_table(columns, more, widths=widths, headings=first))

        return GrowingTable(rows, show)

    def records(self, records: Mapping[str, Mapping[str, object]]) -> None:
        """Print each name with its values below it; nested values have dotted keys."""
        for name, values in records.items():
            self.out.print(_text(name, "bold"))
            for key, value in json_output.flat(values):
                self.out.print(_text(f"  {key:24} {value}"), soft_wrap=True)

    def confirm(self, question: str) -> bool:
        """Ask a yes/no question. Without a terminal the answer is no."""
        prompt = _text(f"{question} [y/N] ")
        return sys.stdin.isatty() and self.err.input(prompt).strip().lower() in ("y", "yes")

    def ask(self, question: str, *, default: str) -> str:
        """Ask for a line of text. An empty line, and no terminal, mean the default."""
        if not sys.stdin.isatty():
            return default
        try:
            return self.err.input(_text(f"{question} ")).strip() or default
        except EOFError:
            return default

    @property
    def interactive(self) -> bool:
        """Whether a person can answer."""
        return sys.stdin.isatty()

    def secret(self, question: str) -> str:
        """Ask for a line that is not shown. Without a terminal it is empty."""
        if not self.interactive:
            return ""
        try:
            return self.err.input(_text(f"{question} "), password=True)
        except EOFError:
            return ""

    def pause(self, text: str) -> bool:
        """Wait for Enter. Returns False after Ctrl-C, and without a terminal."""
        if not self.interactive:
            return False
        try:
            self.err.input(_text(f"{text} "))
        except (EOFError, KeyboardInterrupt):
            return False
        return True

    def result(self, outcomes: Sequence[Outcome], *, json: bool) -> int:
        """Print the outcomes, and return the exit code."""
        if json:
            self.json(outcomes)
        else:
            self.outcomes(outcomes)
        return exit_code(tuple(outcomes))

    def prefixed(self, names: Sequence[str]) -> Callable[[str, str], None]:
        """Return a function that prints a line after a coloured name. Many threads may call it."""
        width = max((len(name) for name in names), default=0)
        styles = {name: _COLOURS[number % len(_COLOURS)] for number, name in enumerate(names)}
        lock = threading.Lock()

        def printer(name: str, text: str) -> None:
            line = Text.from_ansi(terminal.coloured(text))
            with lock:
                self.out.print(Text.assemble((f"{name:{width}} | ", styles[name]), line), soft_wrap=True)

        return printer

    def progress(self) -> AnyProgress:
        """Return live progress on a terminal, or else a line per step."""
        return Bars(self.err) if self.err.is_terminal else Lines(self)


class Lines:
    """Progress without a terminal: one line when a robot starts a step, and one for all if they start the same step."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._announced: set[tuple[str, str]] = set()
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def announce(self, robots: Sequence[str], title: str) -> None:
        """See `fleet.rollout.progress.Progress`. One robot needs no line for all."""
        if len(robots) > 1:
            self._announced |= {(robot, title) for robot in robots}
            self._screen.say(f"{len(robots)} robots: {title}")

    def step_started(self, robot: str, title: str, size: int | None) -> None:
        """See `fleet.rollout.progress.Progress`."""
        with self._lock:
            if (robot, title) in self._announced:
                self._announced.remove((robot, title))
                return
        self._screen.say(f"{robot}: {title}" + (f" ({human_bytes(size)})" if size else ""))

    def bytes_sent(self, robot: str, count: int) -> None:
        """See `fleet.rollout.progress.Progress`."""

    def note(self, robot: str, text: str) -> None:
        """See `fleet.rollout.progress.Progress`."""
        self._screen.say(f"{robot}: {text}")

    def finished(self, outcome: Outcome) -> None:
        """See `fleet.rollout.progress.Progress`."""
        self._screen.say(f"{outcome.robot}: {outcome.status} after {human_seconds(outcome.seconds)}")

    def ended(self, name: str) -> None:
        """Forget a name whose work has no outcome of a robot."""


class WhereBytesFlow(ProgressColumn):
    """A column that stays empty for steps that send nothing."""

    def __init__(self, column: ProgressColumn) -> None:
        super().__init__()
        self._column = column

    def render(self, task: Task) -> RenderableType:
        """See ``rich.progress.ProgressColumn.render``."""
        return self._column.render(task) if task.total else ""


class Bars:
    """A live line per robot: its step, and for transfers the bytes, the speed and the time left."""

    def __init__(self, console: Console) -> None:
        self._moving = Progress(
            SpinnerColumn(),
            TextColumn("[bold]{task.fields[robot]}"),
            TextColumn("{task.description}", markup=False),
            TimeElapsedColumn(),
            WhereBytesFlow(BarColumn(bar_width=24)),
            WhereBytesFlow(DownloadColumn()),
            WhereBytesFlow(TransferSpeedColumn()),
            WhereBytesFlow(TimeRemainingColumn(compact=True)),
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

    def announce(self, robots: Sequence[str], title: str) -> None:
        """See `fleet.rollout.progress.Progress`. Each robot has its own line here."""

    def step_started(self, robot: str, title: str, size: int | None) -> None:
        """See `fleet.rollout.progress.Progress`."""
        with self._lock:
            self._drop(robot)
            self._tasks[robot] = self._moving.add_task(terminal.plain(title), total=size, robot=robot)

    def bytes_sent(self, robot: str, count: int) -> None:
        """See `fleet.rollout.progress.Progress`."""
        with self._lock:
            if robot in self._tasks:  # bytes may still be sent after Ctrl-C has ended the robot's work
                self._moving.advance(self._tasks[robot], count)

    def note(self, robot: str, text: str) -> None:
        """See `fleet.rollout.progress.Progress`."""
        self._moving.console.print(_text(f"{robot}: {text}"), soft_wrap=True)

    def finished(self, outcome: Outcome) -> None:
        """See `fleet.rollout.progress.Progress`."""
        with self._lock:
            self._drop(outcome.robot)

    def ended(self, name: str) -> None:
        """Remove the line of a name whose work has no outcome of a robot."""
        with self._lock:
            self._drop(name)

    def _drop(self, robot: str) -> None:
        task = self._tasks.pop(robot, None)
        if task is not None:
            self._moving.remove_task(task)


AnyProgress = Lines | Bars


def _table(
    columns: Sequence[str],
    rows: Iterable[Sequence[tuple[str, str]]],
    *,
    widths: Sequence[int] = (),
    headings: bool = True,
) -> Table:
    """A table; ``widths`` are the least ones of its columns, so that a part of a table is aligned with what stands above."""
    table = Table(box=None, pad_edge=False, header_style="bold", show_header=headings)
    for column, width in zip(columns, widths or [0] * len(columns), strict=True):
        table.add_column(column, overflow="fold", min_width=max(width, len(column)))
    for row in rows:
        table.add_row(*(_text(_cut(text), style) for text, style in row))
    return table


def _cut(text: str) -> str:
    """The text of a cell: one robot must not fill the screen of all."""
    return text if len(text) <= _LONGEST_CELL else f"{text[:_LONGEST_CELL]}…"


def _text(text: str, style: str = "") -> Text:
    """Return the text without control sequences; brackets in it are not markup."""
    return Text(terminal.plain(text), style=style)
