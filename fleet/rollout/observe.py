"""What does each robot have now?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import FleetError, LinkLost, Unreachable
from fleet.plan.outcome import Outcome
from fleet.rollout.pool import each
from fleet.rollout.reconnect import RETRY_FOR, RetryTimer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress


def observe_one(link: Link, *, images: bool, progress: Progress, retry_for: float = RETRY_FOR) -> Facts:
    """Return one robot's facts, with those of its ``images`` or without. Retry if the connection is lost meanwhile.

    A robot that does not answer the first attempt may be switched off: that is raised at once, without a retry.
    """
    timer, reached = RetryTimer(link, seconds=retry_for, progress=progress), False
    while True:
        try:
            reached = bool(link.session)
            return link.facts(images=images)
        except (LinkLost, Unreachable) as problem:
            if not reached:
                raise
            timer.wait(problem)


LOOK_TIMEOUT = 8.0
"""Seconds to connect, and again for the first words, when a robot is only looked at: TCP has asked four times by then."""


def observe(
    robots: Sequence[Robot], *, progress: Progress, seen: dict[str, Facts | FleetError] | None = None
) -> dict[str, Facts | FleetError]:
    """Return each robot's facts, or the reason why they are missing. ``seen`` is filled as the robots answer."""
    seen = {} if seen is None else seen

    def read(link: Link) -> Outcome:
        try:
            seen[link.robot.name] = link.facts()
        except FleetError as problem:
            seen[link.robot.name] = problem
            raise
        return Outcome(robot=link.robot.name, status="done")

    outcomes = each(robots, read, progress=progress, connect_timeout=LOOK_TIMEOUT)
    for outcome in outcomes:
        seen.setdefault(outcome.robot, LinkLost(outcome.reason, cure=outcome.cure))
    return {robot.name: seen[robot.name] for robot in robots}


def keep_observing(
    robots: Sequence[Robot], seen: dict[str, Facts | FleetError], *, every: float, progress: Progress
) -> None:
    """Update ``seen`` over standing connections until Ctrl-C. ``every`` is in seconds."""

    def read_on(link: Link) -> Outcome:
        while not link.closed.is_set():
            try:
                seen[link.robot.name] = link.facts()
            except FleetError as problem:
                seen[link.robot.name] = problem
                link.reconnect()
            link.closed.wait(every)
        return Outcome(robot=link.robot.name, status="done")

    each(robots, read_on, progress=progress, at_once=len(robots))
