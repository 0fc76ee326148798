"""How is work done on many robots at once?

`each` runs one piece of work per robot in a bounded pool of threads. A robot that fails does not affect the others.
Ctrl-C closes every connection; each robot still gets an outcome.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from fleet.errors import FleetError
from fleet.plan.outcome import Outcome, failure
from fleet.rollout import open_files
from fleet.rollout.link import GOES_ON, Link
from fleet.ssh.connect import CONNECT_TIMEOUT

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fleet.config.inventory import Robot
    from fleet.rollout.progress import Progress

AT_ONCE = 32
"""Robots worked on at the same time: 200 robots are reached in seconds, and a jump host's sshd (MaxStartups) copes."""

SILENT = 0.3
"""Seconds without the first word of an answer, after which a robot does not count as worked on: it may be switched off."""

MOST = 256
"""Robots that are worked on or waited for at the same time: each needs a thread and some open files."""

_TICK = 0.1
"""Seconds between two looks at who is silent, while there are robots that nobody has begun with."""


def each(
    robots: Sequence[Robot],
    work: Callable[[Link], Outcome],
    *,
    progress: Progress,
    at_once: int = AT_ONCE,
    connect_timeout: float = CONNECT_TIMEOUT,
) -> tuple[Outcome, ...]:
    """Run ``work`` for every robot, at most ``at_once`` at a time. Returns the outcomes in the order of ``robots``.

    Robots that do not answer keep no others waiting. ``connect_timeout`` is in seconds and for each of them.

    Raises:
        DesktopError: this computer does not allow so many open files.

    """
    open_files.allow(min(len(robots), max(at_once, MOST)), connecting=AT_ONCE)
    links = [Link(robot, connect_timeout=connect_timeout) for robot in robots]
    crew = _Crew(links, work, at_once=at_once)
    outcomes: dict[str, Outcome] = {}
    try:
        _collect(crew, outcomes, until=len(links), progress=progress)
    except KeyboardInterrupt:
        for link in links:
            link.close()
            if link.robot.name not in outcomes:
                outcomes[link.robot.name] = _interrupted(link)
                progress.finished(outcomes[link.robot.name])
    except BrokenPipeError:  # the reader of the output is gone (`| head`)
        for link in links:
            link.close()
        raise
    return tuple(outcomes[link.robot.name] for link in links)


class _Crew:
    """The threads that work, one for each robot that has been begun with."""

    def __init__(self, links: Sequence[Link], work: Callable[[Link], Outcome], *, at_once: int) -> None:
        self._todo = deque(links)
        self._work = work
        self._at_once = at_once
        self._working: set[Link] = set()
        self._done: queue.SimpleQueue[tuple[Link, Outcome | BaseException]] = queue.SimpleQueue()

    def next(self) -> Outcome | BaseException | None:
        """Begin with as many robots as may be; return what became of one that is through, or None after a moment."""
        self._begin()
        try:  # a wait without a timeout would not notice Ctrl-C
            link, result = self._done.get(timeout=_TICK if self._todo else 0.5)
        except queue.Empty:
            return None
        self._working.remove(link)
        return result

    def _begin(self) -> None:
        busy = sum(link.silence < SILENT for link in self._working) if self._todo else 0
        while self._todo and busy < self._at_once and len(self._working) < max(self._at_once, MOST):
            link = self._todo.popleft()
            self._working.add(link)
            # Daemons: otherwise Python would wait at its end for a thread that is still connecting.
            threading.Thread(target=self._run, args=(link,), daemon=True).start()
            busy += 1

    def _run(self, link: Link) -> None:
        try:
            result: Outcome | BaseException = _one(link, self._work)
        except BaseException as bug:  # noqa: BLE001  raised in the thread that can show it
            result = bug
        finally:
            link.close()
        self._done.put((link, result))


def _interrupted(link: Link) -> Outcome:
    cure = GOES_ON if link.goes_on else ""
    return Outcome(robot=link.robot.name, status="skipped", reason="interrupted by Ctrl-C", cure=cure)


def _collect(
    crew: _Crew,
    outcomes: dict[str, Outcome],
    *,
    until: int,
    progress: Progress,
) -> None:
    bugs: list[BaseException] = []
    while len(outcomes) + len(bugs) < until:
        match crew.next():
            case None:
                pass
            case Outcome() as outcome:
                outcomes[outcome.robot] = outcome
                progress.finished(outcome)
            case BrokenPipeError() as gone:
                raise gone
            case bug:
                bugs.append(bug)
    if bugs:
        raise bugs[0]


def _one(link: Link, work: Callable[[Link], Outcome]) -> Outcome:
    started = time.monotonic()
    try:
        outcome = work(link)
    except FleetError as problem:
        outcome = failure(link.robot.name, problem)
    except OSError as problem:
        if not (refusal := open_files.refusal(problem)):
            raise
        outcome = failure(link.robot.name, refusal)
    return replace(outcome, seconds=time.monotonic() - started)
