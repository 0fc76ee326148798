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
    patience: float = RETRY_FOR,
) -> int:
    """Look at every robot, plan for it, and carry that out, or show the plans with ``dry``. Returns the exit code.

    Where the robot cannot use what was sent, it is looked at again, and the next planner of ``ladder`` has its turn. With
    ``images``, planners are told what robots hold of images; for ``patience`` see `fleet.rollout.apply.apply`.
    """
    plans: dict[str, Plan] = {}

    with screen.progress() as show:

        def attempt(line: Link, make: Planner) -> Outcome:
            show.began(line.robot.name, "look at the robot", None)
            facts = look(line, images=images, watch=show, patience=patience)
            plan = plans[line.robot.name] = make(line.robot, facts)
            if dry:
                return Outcome(robot=plan.robot, status="unchanged", summary=plan.summary)
            return apply(plan, line, open_feed=open_feed or refuse, watch=show, patience=patience)

        outcomes = each(robots, partial(_climb, ladder=ladder, attempt=attempt, watch=show), watch=show)
    if not dry:
        return screen.result(outcomes, json=json)
    made = [plans[robot.name] for robot in robots if robot.name in plans]
    return show_plans(made, outcomes, json=json, screen=screen)


def _climb(
    line: Link, *, ladder: Sequence[Planner], attempt: Callable[[Link, Planner], Outcome], watch: Progress
) -> Outcome:
    """Attempt one planner's way, and the next one's where a robot could not use what came."""
    first, *others = ladder
    outcome = attempt(line, first)
    sent, why = outcome.sent, ""
    for make in others:
        if not outcome.unusable:
            break
        why = outcome.reason.partition("\n")[0]
        watch.told(line.robot.name, f"{why}; trying another way")
        outcome = attempt(line, make)
        sent += outcome.sent
    because = f"{outcome.transfer}, because {why}" if why else outcome.transfer
    return replace(outcome, sent=sent, transfer=because)


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


def observe(robots: Sequence[Robot], *, watch: Progress) -> dict[str, Facts | FleetError]:
    """What each robot has now, or why it cannot be told."""
    seen: dict[str, Facts | FleetError] = {}

    def look(line: Link) -> Outcome:
        try:
            seen[line.robot.name] = line.facts()
        except FleetError as problem:
            seen[line.robot.name] = problem
            raise
        return Outcome(robot=line.robot.name, status="done")

    each(robots, look, watch=watch)
    return {robot.name: seen.get(robot.name, LinkLost("interrupted by Ctrl-C")) for robot in robots}


def keep_observing(
    robots: Sequence[Robot], seen: dict[str, Facts | FleetError], *, every: float, watch: Progress
) -> None:
    """Keep ``seen`` up to date over standing connections, until Ctrl-C; ``every`` is in seconds."""

    def look(line: Link) -> Outcome:
        while not line.closed.is_set():
            try:
                seen[line.robot.name] = line.facts()
            except FleetError as problem:
                seen[line.robot.name] = problem
                line.afresh()
            line.closed.wait(every)
        return Outcome(robot=line.robot.name, status="done")

    each(robots, look, watch=watch, at_once=len(robots))


def refuse(feed: Feed) -> Iterable[bytes]:
    """Open no feed: the steps of most verbs carry their bytes."""
    raise TypeError(f"{feed.label} needs a sender")


def whoami() -> str:
    """Who is at the desktop, for the robots' histories: ``tim@desktop``."""
    return f"{getpass.getuser()}@{socket.gethostname()}"
