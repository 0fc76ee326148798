"""How is one plan carried out on one robot, and what became of it?

A step is believed by its proof only. When the link is lost, a step that resumes is run again on a new connection.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from fleet import terminal
from fleet.errors import LinkLost, NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.plan import compose_steps
from fleet.plan.outcome import Outcome
from fleet.plan.step import Bytes
from fleet.rollout.link import output_of
from fleet.units import human_seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from fleet.plan.step import Feed, Plan, Step
    from fleet.robot.facts import Facts
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress

    Opener = Callable[[Feed], Iterable[bytes]]

RETRY_FOR = 180.0
"""Seconds to try to get a lost link back, counted from the last byte that left."""

_PAUSES = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
"""Seconds between attempts to connect again; the last one for all that follow."""

UNUSABLE = 65
"""The exit code of commands that got all they were to get, and cannot use it (sysexits.h, EX_DATAERR)."""


@runtime_checkable
class InteractiveFeed(Protocol):
    """Bytes to send that depend on what the robot says: it hears that, and is closed when nobody asks any more."""

    on_note: Callable[[str], None]

    def on_output(self, data: bytes) -> None:
        """Take a piece of the robot's output."""

    def close(self) -> None:
        """Nobody asks any more."""

    def __iter__(self) -> Iterator[bytes]:
        """The bytes, as they are asked for."""


def apply(
    plan: Plan,
    link: Link,
    *,
    open_feed: Opener,
    progress: Progress,
    retry_for: float = RETRY_FOR,
) -> Outcome:
    """Carry out one plan.

    A step that can go on where it was is run again when the link comes back within ``retry_for`` seconds. One that fails
    ends the plan: why is asked, what ran before is started again, and both are told.
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
            work.persist(step)
        except RobotError as problem:
            outcome = _failed(plan, step, problem, link, progress=progress, touched=touched)
            return replace(outcome, sent=work.bytes)
    for step in _note(plan, what_came="done"):
        with contextlib.suppress(
            RobotError
        ):  # a robot whose disk is full cannot, and what it runs matters more
            work.persist(step, quietly=True)
    for step in plan.afterwards:
        progress.step_started(plan.robot, step.title, None)
        _ask(step, link)
    return Outcome(robot=plan.robot, status="done", summary=plan.summary, sent=work.bytes, way=plan.way)


def look(link: Link, *, images: bool, progress: Progress, retry_for: float = RETRY_FOR) -> Facts:
    """What a robot has now, asked again where the link is lost meanwhile.

    A robot that cannot be reached in the first place may be switched off: that is told at once.
    """
    timer, reached = _RetryTimer(link, seconds=retry_for, progress=progress), False
    while True:
        try:
            reached = bool(link.session)
            return link.facts(images=images)
        except (LinkLost, Unreachable) as problem:
            if not reached:
                raise
            timer.wait(problem)


class _RetryTimer:
    """How long a link that was lost is tried again, and how often."""

    def __init__(self, link: Link, *, seconds: float, progress: Progress) -> None:
        self._link = link
        self._seconds = seconds
        self._progress = progress
        self.renew()

    def renew(self) -> None:
        """Count from now."""
        self._until, self._pauses = time.monotonic() + self._seconds, iter(_PAUSES)

    def wait(self, problem: RobotError) -> None:
        """Wait before the next attempt, which is on a new connection; raise the problem where there is to be none."""
        left = self._until - time.monotonic()
        if left <= 0 or self._link.closed.is_set():
            raise problem
        self._progress.note(self._link.robot.name, f"{problem.what}; trying again for {human_seconds(left)}")
        self._link.reconnect()
        self._link.closed.wait(min(left, next(self._pauses, _PAUSES[-1])))


class _Work:
    """One plan being carried out: what all of its steps need, and how many bytes they have sent."""

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
        self._link = link
        self._open_feed = open_feed
        self._progress = progress
        self._retry_for = retry_for
        self.bytes = 0

    def persist(self, step: Step, *, quietly: bool = False) -> None:
        """Run a step; when the link is lost under one that resumes, connect again and go on."""
        timer = _RetryTimer(self._link, seconds=self._retry_for, progress=self._progress)
        while True:
            before = self.bytes
            try:
                return self._do(step, quietly=quietly)
            except (LinkLost, Unreachable) as problem:
                if not step.resumes:
                    raise
                if self.bytes > before:
                    timer.renew()
                timer.wait(problem)

    def _do(self, step: Step, *, quietly: bool) -> None:
        if not quietly:
            self._progress.step_started(self._robot, step.title, step.feed.size if step.feed else None)
        feed = self._open(step.feed) if step.feed else None
        if not isinstance(feed, InteractiveFeed):
            _do(step, self._link, feed=feed, on_sent=self._count)
            return
        feed.on_note = lambda text: self._progress.step_started(self._robot, text, None)
        try:
            _do(step, self._link, feed=feed, on_sent=self._count, on_output=feed.on_output)
        finally:
            feed.close()

    def _open(self, feed: Feed) -> Iterable[bytes]:
        return (feed.data,) if isinstance(feed, Bytes) else self._open_feed(feed)

    def _count(self, count: int) -> None:
        self.bytes += count
        self._progress.bytes_sent(self._robot, count)


def _do(
    step: Step,
    link: Link,
    *,
    feed: Iterable[bytes] | None = None,
    on_sent: Callable[[int], None] | None = None,
    on_output: Callable[[bytes], None] | None = None,
) -> None:
    """Run one step and believe only its proof."""
    if step.fresh_login:
        link.reconnect()
    nothing = None if step.until_closed else ()
    said = nothing if feed is None else feed
    result = link.session.run(step.argv, feed=said, limit=step.limit, on_sent=on_sent, on_output=on_output)
    output = output_of(step.argv, result, cure=step.cure)
    # A robot whose login scripts print puts that before the answer: whole lines, so "inactive" is not "active".
    if step.expect is not None and not f"\n{output.strip()}".endswith(f"\n{step.expect.strip()}"):
        last = output.strip().splitlines()[-1:] or ["nothing"]
        raise NotAsPlanned(f"the proof fails: it says {last[0][:200]!r}", cure=step.cure)


def _failed(
    plan: Plan, step: Step, problem: RobotError, link: Link, *, progress: Progress, touched: bool
) -> Outcome:
    reason, cure = _aftermath(plan, problem, link, progress=progress, touched=touched)
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
    plan: Plan, problem: RobotError, link: Link, *, progress: Progress, touched: bool
) -> tuple[str, str]:
    """Ask why, start what ran before (where that was ``touched``), note the failure.

    Returns the reason, with all that was learned, and the cure.
    """
    reason = problem.what
    if isinstance(problem, LinkLost | TimedOut | Unreachable):
        link.reconnect()
    if isinstance(problem, LinkLost | Unreachable):
        return reason, problem.cure or "run the same command again when the robot is back"
    for step in plan.explain if touched else ():
        if said := _ask(step, link):
            reason += "\n" + said
    for step in plan.recover if touched else ():
        progress.step_started(plan.robot, step.title, None)
        try:
            _do(step, link)
            reason += f"\n(went back: {step.title})"
        except RobotError as second:
            reason += f"\nand then `{step.title}` failed: {second.what}"
    for step in _note(plan, what_came=f"failed: {problem.what}"):
        _ask(step, link)
    return reason, problem.cure


def _ask(step: Step, link: Link) -> str:
    try:
        # Compose writes control sequences into logs even where no terminal reads them.
        return terminal.plain(link.session.run(step.argv, limit=step.limit).output).strip()
    except RobotError:
        return ""


def _note(plan: Plan, *, what_came: str) -> tuple[Step, ...]:
    """Keep the history."""
    when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return (compose_steps.note(plan.record, when=when, what_came=what_came),) if plan.record else ()
