"""How does a verb get from its plan function to an exit code? Observe, plan, then print or apply."""

from __future__ import annotations

import getpass
import socket
from typing import TYPE_CHECKING

from fleet.errors import FleetError, LinkLost
from fleet.plan import Bytes, Outcome, exit_code
from fleet.rollout import apply, each

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from fleet.console import Screen
    from fleet.facts import Facts
    from fleet.inventory import Robot
    from fleet.plan import Feed, Plan
    from fleet.rollout import Line, Watch

    Planner = Callable[[Robot, Facts], Plan]
    Opener = Callable[[Feed], Iterable[bytes]]


def execute(
    robots: Sequence[Robot],
    make: Planner,
    *,
    dry: bool,
    json: bool,
    screen: Screen,
    open_feed: Opener | None = None,
) -> int:
    """Look at every robot, plan for it, and carry that out, or show the plans with ``dry``. Returns the exit code."""
    opener = open_feed or held
    plans: dict[str, Plan] = {}

    with screen.progress() as show:

        def work(line: Line) -> Outcome:
            show.began(line.robot.name, "look at the robot", None)
            plan = plans[line.robot.name] = make(line.robot, line.facts())
            if dry:
                return Outcome(robot=plan.robot, status="unchanged", summary=plan.summary)
            return apply(plan, line, open_feed=opener, watch=show)

        outcomes = each(robots, work, watch=show)
    if dry:
        return show_plans(
            [plans[robot.name] for robot in robots if robot.name in plans], outcomes, json=json, screen=screen
        )
    if json:
        screen.json(outcomes)
    else:
        screen.outcomes(outcomes)
    return exit_code(outcomes)


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


def observe(robots: Sequence[Robot], *, watch: Watch) -> dict[str, Facts | FleetError]:
    """What each robot has now, or why it cannot be told."""
    seen: dict[str, Facts | FleetError] = {}

    def look(line: Line) -> Outcome:
        try:
            seen[line.robot.name] = line.facts()
        except FleetError as problem:
            seen[line.robot.name] = problem
            raise
        return Outcome(robot=line.robot.name, status="done")

    each(robots, look, watch=watch)
    return {robot.name: seen.get(robot.name, LinkLost("interrupted by Ctrl-C")) for robot in robots}


def keep_observing(
    robots: Sequence[Robot], seen: dict[str, Facts | FleetError], *, every: float, watch: Watch
) -> None:
    """Keep ``seen`` up to date over standing connections, until Ctrl-C; ``every`` is in seconds."""

    def look(line: Line) -> Outcome:
        while not line.closed.is_set():
            try:
                seen[line.robot.name] = line.facts()
            except FleetError as problem:
                seen[line.robot.name] = problem
                line.afresh()
            line.closed.wait(every)
        return Outcome(robot=line.robot.name, status="done")

    each(robots, look, watch=watch, at_once=len(robots))


def held(feed: Feed) -> Iterable[bytes]:
    """The bytes of a feed that the plan itself holds."""
    if not isinstance(feed, Bytes):
        raise TypeError(f"{feed.label} needs an opener")
    return (feed.data,)


def whoami() -> str:
    """Who is at the desktop, for the robots' histories: ``tim@desktop``."""
    return f"{getpass.getuser()}@{socket.gethostname()}"
