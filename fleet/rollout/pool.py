"""How is work done on many robots at once?

`each` runs one piece of work per robot in a bounded pool of threads. A robot that fails does not affect the others.
Ctrl-C closes every connection; each robot still gets an outcome.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from fleet.errors import FleetError
from fleet.plan.outcome import Outcome, failure
from fleet.rollout.link import GOES_ON, Link

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fleet.config.inventory import Robot
    from fleet.rollout.progress import Progress

AT_ONCE = 32
"""Robots worked on at the same time: 200 robots are reached in seconds, and a jump host's sshd (MaxStartups) copes."""


def each(
    robots: Sequence[Robot],
    work: Callable[[Link], Outcome],
    *,
    progress: Progress,
    at_once: int = AT_ONCE,
) -> tuple[Outcome, ...]:
    """Run ``work`` for every robot, at most ``at_once`` at a time. Returns the outcomes in the order of ``robots``."""
    links = [Link(robot) for robot in robots]
    todo: queue.SimpleQueue[Link] = queue.SimpleQueue()
    done: queue.SimpleQueue[Outcome | BaseException] = queue.SimpleQueue()
    for link in links:
        todo.put(link)
    for _ in range(min(at_once, len(links))):
        # Daemons: otherwise Python would wait at its end for a thread that is still connecting.
        threading.Thread(target=_work_off, args=(todo, done, work), daemon=True).start()
    outcomes: dict[str, Outcome] = {}
    try:
        _collect(done, outcomes, until=len(links), progress=progress)
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


def _interrupted(link: Link) -> Outcome:
    cure = GOES_ON if link.goes_on else ""
    return Outcome(robot=link.robot.name, status="skipped", reason="interrupted by Ctrl-C", cure=cure)


def _work_off(
    todo: queue.SimpleQueue[Link],
    done: queue.SimpleQueue[Outcome | BaseException],
    work: Callable[[Link], Outcome],
) -> None:
    while True:
        try:
            link = todo.get_nowait()
        except queue.Empty:
            return
        try:
            done.put(_one(link, work))
        except BaseException as bug:  # noqa: BLE001  raised in the thread that can show it
            done.put(bug)
        finally:
            link.close()


def _collect(
    done: queue.SimpleQueue[Outcome | BaseException],
    outcomes: dict[str, Outcome],
    *,
    until: int,
    progress: Progress,
) -> None:
    bugs: list[BaseException] = []
    while len(outcomes) + len(bugs) < until:
        try:
            result = done.get(timeout=0.5)  # a wait without a timeout would not notice Ctrl-C
        except queue.Empty:
            continue
        if isinstance(result, Outcome):
            outcomes[result.robot] = result
            progress.finished(result)
        elif isinstance(result, BrokenPipeError):
            raise result
        else:
            bugs.append(result)
    if bugs:
        raise bugs[0]


def _one(link: Link, work: Callable[[Link], Outcome]) -> Outcome:
    started = time.monotonic()
    try:
        outcome = work(link)
    except FleetError as problem:
        outcome = failure(link.robot.name, problem)
    return replace(outcome, seconds=time.monotonic() - started)
