"""How does a verb get from its plan function to an exit code? Observe, plan, then print or apply."""

from __future__ import annotations

import getpass
import socket
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from fleet.errors import FleetError, LinkLost
from fleet.plan.outcome import Outcome, exit_code
from fleet.rollout.apply import RETRY_FOR, apply, look
from fleet.rollout.pool import each

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from fleet.cli.console import Screen
    from fleet.config.inventory import Robot
    from fleet.plan.step import Feed, Plan
    from fleet.robot.facts import Facts
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress

    Planner = Callable[[Robot, Facts], Plan]
    Opener = Callable[[Feed], Iterable[bytes]]


def execute(
    robots: Sequence[Robot],
    *ladder: Planner,
    dry: bool,
    json: bool,
    screen: Screen,
    open_feed: Opener | None = None,
    images: bool = False,
    retry_for: float = RETRY_FOR,
) -> int:
    """Look at every robot, plan for it, and carry that out, or show the plans with ``dry``. Returns the exit code.

    Where the robot cannot use what was sent, it is looked at again, and the next planner of ``ladder`` has its turn. With
    ``images``, planners are told what robots hold of images; for ``retry_for`` see `fleet.rollout.apply.apply`.
    """
    plans: dict[str, Plan] = {}

    with screen.progress() as progress:

        def attempt(link: Link, make: Planner) -> Outcome:
            progress.step_started(link.robot.name, "look at the robot", None)
            facts = look(link, images=images, progress=progress, retry_for=retry_for)
            plan = plans[link.robot.name] = make(link.robot, facts)
            if dry:
                return Outcome(robot=plan.robot, status="unchanged", summary=plan.summary)
            return apply(plan, link, open_feed=open_feed or refuse, progress=progress, retry_for=retry_for)

        outcomes = each(
            robots, partial(_climb, ladder=ladder, attempt=attempt, progress=progress), progress=progress
        )
    if not dry:
        return screen.result(outcomes, json=json)
    made = [plans[robot.name] for robot in robots if robot.name in plans]
    return show_plans(made, outcomes, json=json, screen=screen)


def _climb(
    link: Link, *, ladder: Sequence[Planner], attempt: Callable[[Link, Planner], Outcome], progress: Progress
) -> Outcome:
    """Attempt one planner's way, and the next one's where a robot could not use what came."""
    first, *others = ladder
    outcome = attempt(link, first)
    sent, why = outcome.sent, ""
    for make in others:
        if not outcome.unusable:
            break
        why = outcome.reason.partition("\n")[0]
        progress.note(link.robot.name, f"{why}; trying another way")
        outcome = attempt(link, make)
        sent += outcome.sent
    because = f"{outcome.way}, because {why}" if why else outcome.way
    return replace(outcome, sent=sent, way=because)


def show_plans(plans: Sequence[Plan], outcomes: Sequence[Outcome], *, json: bool, screen: Screen) -> int:
    """Print what would be done, and which robots cannot be planned for."""
    bad = tuple(outcome for outcome in outcomes if not outcome.good)
    if json:
        screen.json({"plans": plans, "problems": bad})
    else:
        screen.plans(plans)
        if bad:
            screen.outcomes(bad)
        screen.say("nothing was changed (--dry)")
    return exit_code(bad)


def observe(robots: Sequence[Robot], *, progress: Progress) -> dict[str, Facts | FleetError]:
    """What each robot has now, or why it cannot be told."""
    seen: dict[str, Facts | FleetError] = {}

    def look(link: Link) -> Outcome:
        try:
            seen[link.robot.name] = link.facts()
        except FleetError as problem:
            seen[link.robot.name] = problem
            raise
        return Outcome(robot=link.robot.name, status="done")

    each(robots, look, progress=progress)
    return {robot.name: seen.get(robot.name, LinkLost("interrupted by Ctrl-C")) for robot in robots}


def keep_observing(
    robots: Sequence[Robot], seen: dict[str, Facts | FleetError], *, every: float, progress: Progress
) -> None:
    """Keep ``seen`` up to date over standing connections, until Ctrl-C; ``every`` is in seconds."""

    def look(link: Link) -> Outcome:
        while not link.closed.is_set():
            try:
                seen[link.robot.name] = link.facts()
            except FleetError as problem:
                seen[link.robot.name] = problem
                link.reconnect()
            link.closed.wait(every)
        return Outcome(robot=link.robot.name, status="done")

    each(robots, look, progress=progress, at_once=len(robots))


def refuse(feed: Feed) -> Iterable[bytes]:
    """Open no feed: the steps of most verbs carry their bytes."""
    raise TypeError(f"{feed.label} needs a sender")


def whoami() -> str:
    """Who is at the desktop, for the robots' histories: ``tim@desktop``."""
    return f"{getpass.getuser()}@{socket.gethostname()}"
