"""How is one plan carried out on one robot?

A step counts as done only when its proof succeeds. If the connection is lost, a step that can resume is run again on a
new connection.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from fleet import terminal
from fleet.diagnosis.explain import explain
from fleet.errors import CommandFailed, LinkLost, NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.onboard.exit_codes import UNUSABLE
from fleet.plan import compose_steps
from fleet.plan.outcome import Outcome
from fleet.plan.step import Bytes
from fleet.rollout.link import GOES_ON, output_of
from fleet.rollout.reconnect import RETRY_FOR, RetryTimer
from fleet.ssh.channel import KEPT, Kept

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from fleet.plan.step import Feed, Plan, Step
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress
    from fleet.ssh.session import Stream

    Opener = Callable[[Feed], Iterable[bytes]]


NOTE = "note:"
"""How a line begins that a script on a robot writes for the person who waits for it."""

NOW = "now:"
"""The same, for a line that holds until the next one: how far a long step is, or what it waits for."""

AGAIN = "run the same command again when the robot is back"

_TOLD = 32_000
"""Characters from the end of what a command printed that are told."""

_MOST_NOTES = 200
"""Notes of one script that are shown: a robot may print them without end."""


@runtime_checkable
class InteractiveFeed(Protocol):
    """An input stream that reacts to the command's output. It is closed when the command ends."""

    on_note: Callable[[str], None]

    def on_output(self, data: bytes) -> None:
        """Take the next bytes of the command's output."""

    def close(self) -> None:
        """Stop: no more bytes are needed."""

    def __iter__(self) -> Iterator[bytes]:
        """Yield the bytes to send."""


@runtime_checkable
class ServingFeed(InteractiveFeed, Protocol):
    """One that also answers connections which the robot makes to a port of its own, through SSH."""

    on_served: Callable[[int], None]

    def begin(self, port: int) -> None:
        """Be told which port of the robot's loopback it is."""

    def serve(self, stream: Stream) -> None:
        """Answer one connection, until it ends."""


def apply(
    plan: Plan,
    link: Link,
    *,
    open_feed: Opener,
    progress: Progress,
    retry_for: float = RETRY_FOR,
) -> Outcome:
    """Carry out one plan.

    If the connection is lost, it is retried for ``retry_for`` seconds, counted from the last byte that was sent, and a
    step that can resume is run again. A step that fails ends the plan: the robot is asked for the reason, what was begun is
    undone, and the outcome reports both.
    """
    if not plan.steps:
        return Outcome(robot=plan.robot, status="unchanged", summary=plan.summary)
    work = _Work(plan, link, open_feed=open_feed, progress=progress, retry_for=retry_for)
    if plan.forecast:
        progress.note(plan.robot, plan.forecast)
    touched = False
    for step in plan.steps:
        touched = touched or not step.harmless
        try:
            work.run(step)
        except RobotError as problem:
            outcome = _failed(plan, step, problem, link, progress=progress, touched=touched)
            return replace(outcome, sent=work.bytes)
    for step in _note(plan, outcome="done"):
        # A full disk has no room for a line of history, and the release that runs matters more.
        with contextlib.suppress(RobotError):
            work.run(step, quietly=True)
    for step in plan.afterwards:
        progress.step_started(plan.robot, step.title, None)
        _ask(step, link)
    return Outcome(
        robot=plan.robot, status="done", summary=plan.summary, sent=work.bytes, transfer=plan.transfer
    )


class _Notes:
    """The lines of a script's output that are for the person who waits for it."""

    def __init__(self, note: Callable[[str], None], now: Callable[[str], None]) -> None:
        self._shows = {NOTE: note, NOW: now}
        self._rest = b""
        self._left = _MOST_NOTES

    def hear(self, data: bytes) -> None:
        """Take a piece of output; of a line without an end, the first 4 kB."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[:4096]
        for line in lines:
            text = terminal.plain(line[:4096].decode(errors="replace"))
            word, colon, told = text.partition(":")
            if (show := self._shows.get(word + colon)) and self._left:
                self._left -= 1
                show(told.strip())


class _Work:
    """A plan while it is carried out: what its steps need, and the number of bytes they have sent."""

    def __init__(
        self,
        plan: Plan,
        link: Link,
        *,
        open_feed: Opener,
        progress: Progress,
        retry_for: float,
    ) -> None:
        self._robot = plan.robot
        self._verb = plan.verb
        self._link = link
        self._open_feed = open_feed
        self._progress = progress
        self._retry_for = retry_for
        self.bytes = 0

    def run(self, step: Step, *, quietly: bool = False) -> None:
        """Run a step. If the connection is lost and the step can resume, reconnect and run it again."""
        timer = RetryTimer(self._link, seconds=self._retry_for, progress=self._progress)
        while True:
            before = self.bytes
            try:
                return self._do(step, quietly=quietly)
            except (LinkLost, Unreachable) as problem:
                if not step.resumes:
                    raise
                if self.bytes > before:
                    timer.restart()
                timer.wait(problem)

    def _do(self, step: Step, *, quietly: bool) -> None:
        if not quietly:
            self._progress.step_started(
                self._robot, step.title, (step.feed.size or None) if step.feed else None
            )
        if step.detached:
            self._attend(step)
            return
        feed = self._open(step.feed) if step.feed else None
        if not isinstance(feed, InteractiveFeed):
            _do(step, self._link, verb=self._verb, feed=feed, on_sent=self._count, notes=self._notes())
            return
        feed.on_note = lambda text: self._progress.step_started(self._robot, text, None)
        with contextlib.ExitStack() as stack:
            if isinstance(feed, ServingFeed):
                feed.on_served = self._count
                feed.begin(stack.enter_context(self._link.session.forwarded(feed.serve)))
            stack.callback(feed.close)
            _do(
                step,
                self._link,
                verb=self._verb,
                feed=feed,
                on_sent=None if isinstance(feed, ServingFeed) else self._count,
                on_output=feed.on_output,
            )

    def _notes(self) -> _Notes:
        return _Notes(
            note=lambda text: self._progress.note(self._robot, text),
            now=lambda text: self._progress.step_started(self._robot, text, None),
        )

    def _attend(self, step: Step) -> None:
        """Wait for what goes on without this computer. Its notes are shown as they come; its errors are kept whole."""
        notes = self._notes()
        self._link.goes_on = True
        result = self._link.session.run(step.argv, limit=step.limit, on_output=notes.hear)
        self._link.goes_on = False
        if result.code:
            # Compose writes control sequences into logs even without a terminal.
            text = terminal.plain(result.errors[-_TOLD:]).strip() or f"it ended with code {result.code}"
            cure = explain(text, verb=self._verb)[1] or step.cure
            raise CommandFailed(text, cure=cure, code=result.code, output=text)

    def _open(self, feed: Feed) -> Iterable[bytes]:
        return (feed.data,) if isinstance(feed, Bytes) else self._open_feed(feed)

    def _count(self, count: int) -> None:
        self.bytes += count
        self._progress.bytes_sent(self._robot, count)


def _do(
    step: Step,
    link: Link,
    *,
    verb: str = "",
    feed: Iterable[bytes] | None = None,
    on_sent: Callable[[int], None] | None = None,
    on_output: Callable[[bytes], None] | None = None,
    notes: _Notes | None = None,
) -> None:
    """Run one step and check its proof. The output's lines for a person go to ``notes`` as they come."""
    if step.fresh_login:
        link.reconnect()
    no_input = None if step.until_closed else ()
    stdin = no_input if feed is None else feed
    gathered = Kept(KEPT)

    def hear(data: bytes) -> None:
        gathered.add(data)
        if notes:
            notes.hear(data)

    result = link.session.run(
        step.argv, feed=stdin, limit=step.limit, on_sent=on_sent, on_output=on_output or hear
    )
    if not on_output:
        result = replace(result, output=gathered.text())
    output = output_of(step.argv, result, cure=step.cure, verb=verb)
    # Login scripts may print lines before the answer. Whole lines are compared, so "inactive" is not "active".
    if step.expect is not None and not f"\n{output.strip()}".endswith(f"\n{step.expect.strip()}"):
        last = output.strip().splitlines()[-1:] or ["nothing"]
        raise NotAsPlanned(f"the check after this step failed: it printed {last[0][:200]!r}", cure=step.cure)


def _failed(
    plan: Plan, step: Step, problem: RobotError, link: Link, *, progress: Progress, touched: bool
) -> Outcome:
    reason, cure = _aftermath(plan, step, problem, link, progress=progress, touched=touched)
    unusable = isinstance(problem, NotAsPlanned) or getattr(problem, "code", 0) == UNUSABLE
    return Outcome(
        robot=plan.robot,
        status="failed",
        step=step.title,
        reason=reason,
        cure=cure,
        unusable=unusable and not touched,
    )


def _aftermath(
    plan: Plan, step: Step, problem: RobotError, link: Link, *, progress: Progress, touched: bool
) -> tuple[str, str]:
    """Ask for the reason, undo what was begun if the robot was ``touched``, and write the failure into the history.

    Returns the reason with all details, and the cure.
    """
    reason, cure = problem.what, problem.cure
    if isinstance(problem, LinkLost | TimedOut | Unreachable):
        link.reconnect()
    if isinstance(problem, LinkLost | Unreachable):
        return reason, GOES_ON if step.detached else cure or AGAIN
    if details := "\n".join(filter(None, (_ask(question, link) for question in plan.explain if touched))):
        reason, cure = _enlightened(problem, details, verb=plan.verb)
    told = reason.partition("\n")[0]
    for undoing in plan.recover if touched else ():
        progress.step_started(plan.robot, undoing.title, None)
        try:
            _do(undoing, link)
            reason += f"\n(went back: {undoing.title})"
        except RobotError as second:
            reason += f"\nand then `{undoing.title}` failed: {second.what}"
    for note in _note(plan, outcome=f"failed: {told}"):
        _ask(note, link)
    return reason, cure


def _enlightened(problem: RobotError, details: str, *, verb: str) -> tuple[str, str]:
    """The reason and the cure of a failure, if the robot was asked for ``details``: these may have the cause."""
    what, cure = problem.what, problem.cure
    if isinstance(problem, CommandFailed):
        cause, known_cure = explain(problem.output, code=problem.code, verb=verb, details=details)
        what, cure = cause or what, known_cure or cure
    elif not cure:
        cure = explain("", verb=verb, details=details)[1]
    return f"{what}\n{details}", cure


def _ask(step: Step, link: Link) -> str:
    try:
        # Compose writes control sequences into logs even without a terminal.
        return terminal.plain(link.session.run(step.argv, limit=step.limit).output[-_TOLD:]).strip()
    except RobotError:
        return ""


def _note(plan: Plan, *, outcome: str) -> tuple[Step, ...]:
    """Return the step that writes the history, if the plan keeps one."""
    when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return (compose_steps.note(plan.record, when=when, outcome=outcome),) if plan.record else ()
