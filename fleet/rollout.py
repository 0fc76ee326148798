"""How do many robots get their plans, and what became of each?

`each` runs one piece of work per robot in a bounded pool of threads; `apply` carries out one plan on one robot. A
robot's failure is its outcome, never the others'. Ctrl-C closes every connection, and says what became of each robot.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol

from fleet import diagnosis, facts, layout, ssh, terminal
from fleet.errors import CommandFailed, FleetError, LinkLost, NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.plan import Outcome, failure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from fleet.inventory import Robot
    from fleet.plan import Feed, Plan, Step

AT_ONCE = 32
"""Robots worked on at the same time: 200 robots are reached in seconds, and sshd's MaxStartups is not tripped."""


class Watch(Protocol):
    """Whoever is told how it goes; called from many threads."""

    def began(self, robot: str, title: str, size: int | None) -> None:
        """A robot starts something; ``size`` is in bytes where bytes will flow."""

    def sent(self, robot: str, count: int) -> None:
        """So many more bytes have left."""

    def ended(self, outcome: Outcome) -> None:
        """A robot is through."""


class Silence:
    """Progress that nobody is shown: what a verb prints tells enough."""

    def began(self, robot: str, title: str, size: int | None) -> None:
        """See `Watch`."""

    def sent(self, robot: str, count: int) -> None:
        """See `Watch`."""

    def ended(self, outcome: Outcome) -> None:
        """See `Watch`."""


class Line:
    """The line to one robot: connects when first used, can connect afresh, and is closed from outside on Ctrl-C."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._session: ssh.Session | None = None
        self.closed = threading.Event()

    @property
    def session(self) -> ssh.Session:
        """The connection. Raises what `fleet.ssh.connect` raises."""
        if self.closed.is_set():
            raise LinkLost("interrupted by Ctrl-C")
        if self._session is None:
            self._session = ssh.connect(self.robot)
            if self.closed.is_set():  # Ctrl-C came while it connected
                self._session.close()
        return self._session

    def afresh(self) -> None:
        """Connect anew at the next use: group membership is read at login."""
        if self._session:
            self._session.close()
        self._session = None

    def close(self) -> None:
        """Close for good; whatever runs on it ends at once."""
        self.closed.set()
        if self._session:
            self._session.close()

    def run(self, *argv: str, limit: float = 60.0) -> str:
        """The output of a command that must succeed. Raises `CommandFailed`, or what the session raises."""
        return _succeed(argv, self.session.run(argv, limit=limit))

    def facts(self) -> facts.Facts:
        """What the robot has now, in one round trip."""
        answer = self.session.run(("sh", "-c", facts.PROBE), limit=30)
        if f"{facts.MARK} end" not in answer.output:
            raise NotAsPlanned(
                f"the robot's shell did not run the probe: {answer.errors.strip() or 'no answer'}"
            )
        return facts.parse(answer.output)


def each(
    robots: Sequence[Robot],
    work: Callable[[Line], Outcome],
    *,
    watch: Watch,
    at_once: int = AT_ONCE,
) -> tuple[Outcome, ...]:
    """Run ``work`` for every robot, at most ``at_once`` at a time; an outcome for each, in the order of ``robots``."""
    lines = [Line(robot) for robot in robots]
    todo: queue.SimpleQueue[Line] = queue.SimpleQueue()
    done: queue.SimpleQueue[Outcome | BaseException] = queue.SimpleQueue()
    for line in lines:
        todo.put(line)
    for _ in range(min(at_once, len(lines))):
        # Daemons, because Python would wait at its end for a thread that is still connecting.
        threading.Thread(target=_work_off, args=(todo, done, work), daemon=True).start()
    outcomes: dict[str, Outcome] = {}
    try:
        _collect(done, outcomes, until=len(lines), watch=watch)
    except KeyboardInterrupt:
        for line in lines:
            line.close()
            name = line.robot.name
            if name not in outcomes:
                outcomes[name] = Outcome(robot=name, status="skipped", reason="interrupted by Ctrl-C")
                watch.ended(outcomes[name])
    except BrokenPipeError:  # nobody reads any more what the robots say
        for line in lines:
            line.close()
        raise
    return tuple(outcomes[line.robot.name] for line in lines)


def apply(plan: Plan, line: Line, *, open_feed: Callable[[Feed], Iterable[bytes]], watch: Watch) -> Outcome:
    """Carry out one plan. A step that fails ends it: why is asked, what ran before is started again, and both are told."""
    if not plan.steps:
        return Outcome(robot=plan.robot, status="unchanged", summary=plan.summary)
    sent = 0

    def tell(count: int) -> None:
        nonlocal sent
        sent += count
        watch.sent(plan.robot, count)

    touched = False
    for step in plan.steps:
        touched = touched or not step.harmless
        watch.began(plan.robot, step.title, step.feed.size if step.feed else None)
        try:
            _do(step, line, open_feed=open_feed, tell=tell)
        except RobotError as problem:
            reason, cure = _aftermath(plan, problem, line, watch=watch, touched=touched)
            return Outcome(
                robot=plan.robot, status="failed", step=step.title, reason=reason, cure=cure, sent=sent
            )
    _note(plan, line, what_came="done")
    return Outcome(robot=plan.robot, status="done", summary=plan.summary, sent=sent)


def _work_off(
    todo: queue.SimpleQueue[Line],
    done: queue.SimpleQueue[Outcome | BaseException],
    work: Callable[[Line], Outcome],
) -> None:
    while True:
        try:
            line = todo.get_nowait()
        except queue.Empty:
            return
        try:
            done.put(_one(line, work))
        except BaseException as bug:  # noqa: BLE001  raised in the thread that can show it
            done.put(bug)
        finally:
            line.close()


def _collect(
    done: queue.SimpleQueue[Outcome | BaseException],
    outcomes: dict[str, Outcome],
    *,
    until: int,
    watch: Watch,
) -> None:
    bugs: list[BaseException] = []
    while len(outcomes) + len(bugs) < until:
        try:
            came = done.get(timeout=0.5)  # a wait without end would not notice Ctrl-C
        except queue.Empty:
            continue
        if isinstance(came, Outcome):
            outcomes[came.robot] = came
            watch.ended(came)
        elif isinstance(came, BrokenPipeError):
            raise came
        else:
            bugs.append(came)
    if bugs:
        raise bugs[0]


def _one(line: Line, work: Callable[[Line], Outcome]) -> Outcome:
    started = time.monotonic()
    try:
        outcome = work(line)
    except FleetError as problem:
        outcome = failure(line.robot.name, problem)
    return replace(outcome, seconds=time.monotonic() - started)


def _do(
    step: Step, line: Line, *, open_feed: Callable[[Feed], Iterable[bytes]], tell: Callable[[int], None]
) -> None:
    """Run one step and believe only its proof."""
    if step.fresh_login:
        line.afresh()
    nothing = None if step.until_closed else ()
    feed = open_feed(step.feed) if step.feed else nothing
    result = line.session.run(step.argv, feed=feed, limit=step.limit, sent=tell)
    output = _succeed(step.argv, result, cure=step.cure)
    # A robot whose login scripts print puts that before the answer: whole lines, so "inactive" is not "active".
    if step.expect is not None and not f"\n{output.strip()}".endswith(f"\n{step.expect.strip()}"):
        said = output.strip().splitlines()[-1:] or ["nothing"]
        raise NotAsPlanned(f"the proof fails: it says {said[0][:200]!r}", cure=step.cure)


def _succeed(argv: Sequence[str], result: ssh.Result, *, cure: str = "") -> str:
    if result.code == 0:
        return result.output
    said = result.errors.strip() or result.output.strip()
    what, known_cure = diagnosis.explain(said)
    raise CommandFailed(
        what or f"`{argv[0]}` ended with code {result.code}",
        cure=known_cure or cure,
        code=result.code,
        output=said,
    )


def _aftermath(
    plan: Plan, problem: RobotError, line: Line, *, watch: Watch, touched: bool
) -> tuple[str, str]:
    """Ask why, start what ran before (where that was ``touched``), note the failure.

    Returns the reason, with all that was learned, and the cure.
    """
    reason = problem.what
    if isinstance(problem, LinkLost | TimedOut | Unreachable):
        line.afresh()
    if isinstance(problem, LinkLost | Unreachable):
        return reason, problem.cure or "run the same command again when the robot is back"
    for step in plan.explain if touched else ():
        if said := _ask(step, line):
            reason += "\n" + said
    for step in plan.recover if touched else ():
        watch.began(plan.robot, step.title, None)
        try:
            _do(step, line, open_feed=lambda _: (), tell=lambda _: None)
            reason += f"\n(went back: {step.title})"
        except RobotError as second:
            reason += f"\nand then `{step.title}` failed: {second.what}"
    _note(plan, line, what_came=f"failed: {problem.what}")
    return reason, problem.cure


def _ask(step: Step, line: Line) -> str:
    try:
        # Compose writes control sequences into logs even where no terminal reads them.
        return terminal.plain(line.session.run(step.argv, limit=step.limit).output).strip()
    except RobotError:
        return ""


def _note(plan: Plan, line: Line, *, what_came: str) -> None:
    """Keep the history; a robot whose disk is full cannot, and what it runs matters more."""
    if plan.record:
        when = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        _ask(layout.note(plan.record, when=when, what_came=what_came), line)
