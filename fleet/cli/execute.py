"""How does a verb get from its planner to an exit code? Observe, plan, then print or apply."""

from __future__ import annotations

import getpass
import socket
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from fleet.plan.outcome import Outcome, exit_code, together
from fleet.rollout.apply import apply
from fleet.rollout.observe import observe_one
from fleet.rollout.pool import each
from fleet.rollout.reconnect import RETRY_FOR

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from fleet.cli.console import Screen
    from fleet.config.inventory import Robot
    from fleet.plan.step import Feed, Plan
    from fleet.robot.facts import Facts
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress

    Planner = Callable[[Robot, Facts], Sequence[Plan]]
    Opener = Callable[[Feed], Iterable[bytes]]


OBSERVE = "look at the robot"
"""The title of every robot's first step."""

PREPARE = "prepare what it lacks"
"""The title of what follows where bytes are sent: layers come out of this computer's Docker, and are packed."""


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
    """Observe every robot, plan for it, and apply the plan, or print it with ``dry``. Returns the exit code.

    If a robot cannot use what was sent, it is observed again, and the next planner of ``ladder`` makes the plan. With
    ``images``, the facts include the robot's images. For ``retry_for`` see `fleet.rollout.apply.apply`.
    """
    plans: dict[str, Sequence[Plan]] = {}

    with screen.progress() as progress:
        progress.announce([robot.name for robot in robots], OBSERVE)

        def carry_out(link: Link, made: Sequence[Plan]) -> Outcome:
            plans[link.robot.name] = made
            if dry:
                steps = any(plan.steps for plan in made)
                return Outcome(robot=link.robot.name, status="planned" if steps else "unchanged")
            feeds = open_feed or refuse
            return _apply_all(link, made, open_feed=feeds, progress=progress, retry_for=retry_for)

        facts = partial(observe_one, images=images, progress=progress, retry_for=retry_for)
        climb = partial(
            _climb, ladder, facts=facts, sends=bool(open_feed), carry_out=carry_out, progress=progress
        )
        outcomes = each(robots, climb, progress=progress)
    if not dry:
        return screen.result(outcomes, json=json)
    in_order = [plan for robot in robots for plan in plans.get(robot.name, ())]
    return show_plans(in_order, outcomes, json=json, screen=screen)


def bring(
    link: Link,
    *ladder: Planner,
    open_feed: Opener,
    progress: Progress,
    retry_for: float = RETRY_FOR,
) -> Outcome:
    """Observe one robot with its images, plan for it, and apply the plan; for ``ladder`` see `execute`."""
    carry_out = partial(_apply_all, open_feed=open_feed, progress=progress, retry_for=retry_for)
    facts = partial(observe_one, images=True, progress=progress, retry_for=retry_for)
    return _climb(ladder, link, facts=facts, sends=True, carry_out=carry_out, progress=progress)


def _apply_all(
    link: Link, plans: Sequence[Plan], *, open_feed: Opener, progress: Progress, retry_for: float
) -> Outcome:
    """Apply the plans of a robot's stacks, one after the other."""
    outcomes: list[tuple[str, Outcome]] = []
    for plan in plans:
        outcome = apply(plan, link, open_feed=open_feed, progress=progress, retry_for=retry_for)
        outcomes.append((plan.stack, outcome))
        if outcome.unusable:
            break  # the next planner begins with what is left
    return together(link.robot.name, outcomes)


def _climb(
    ladder: Sequence[Planner],
    link: Link,
    *,
    facts: Callable[[Link], Facts],
    sends: bool,
    carry_out: Callable[[Link, Sequence[Plan]], Outcome],
    progress: Progress,
) -> Outcome:
    """Carry out the first planner's plan, and the next one's if the robot could not use what was sent."""
    sent, why = 0, ""
    for number, make in enumerate(ladder, start=1):
        progress.step_started(link.robot.name, OBSERVE, None)
        there = facts(link)
        if sends:
            progress.step_started(link.robot.name, PREPARE, None)
        outcome = carry_out(link, make(link.robot, there))
        sent += outcome.sent
        if not outcome.unusable or number == len(ladder):
            break
        why = outcome.reason.partition("\n")[0]
        progress.note(link.robot.name, f"{why}; trying another way")
    because = f"{outcome.transfer}, because {why}" if why else outcome.transfer
    return replace(outcome, sent=sent, transfer=because)


def show_plans(plans: Sequence[Plan], outcomes: Sequence[Outcome], *, json: bool, screen: Screen) -> int:
    """Print the plans, and the robots for which there is none."""
    bad = tuple(outcome for outcome in outcomes if not outcome.good)
    if json:
        screen.json({"plans": plans, "problems": bad})
    else:
        screen.plans(plans)
        if bad:
            screen.outcomes(bad)
        screen.say("nothing was changed (--dry)")
    return exit_code(bad)


def refuse(feed: Feed) -> Iterable[bytes]:
    """Refuse to open a feed: the steps of most verbs hold their bytes themselves."""
    raise TypeError(f"{feed.label} needs a sender")


def whoami() -> str:
    """Return the desktop's user for the robots' histories, such as ``tim@desktop``."""
    return f"{getpass.getuser()}@{socket.gethostname()}"
