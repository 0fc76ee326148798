"""Which verb brings saved files to robots at once? ``fab dev``."""

from __future__ import annotations

import contextlib
import secrets
from functools import partial
from typing import TYPE_CHECKING

from fleet.cli import build, wanted, whose
from fleet.cli.console import Screen
from fleet.cli.deploy import Options, Planner
from fleet.cli.execute import bring, execute, whoami
from fleet.cli.registry_access import login_of
from fleet.cli.selection import select
from fleet.cli.stacks import Stacks, stacks_there, warnings_of
from fleet.cli.verb import verb
from fleet.config import watch
from fleet.errors import UsageError
from fleet.images import builder
from fleet.images.docker_cli import buildkit_client
from fleet.images.store import Store
from fleet.plan import dev_steps, prune, readiness
from fleet.plan.compose_steps import Request
from fleet.rollout.dev import Target, follow
from fleet.transfer.delivery import STRATEGIES
from fleet.transfer.rate_limit import RateLimiter
from fleet.transfer.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.cli.console import AnyProgress
    from fleet.cli.stacks import RobotStack
    from fleet.config.inventory import Robot
    from fleet.plan.outcome import Outcome
    from fleet.plan.step import Plan
    from fleet.robot.facts import Facts
    from fleet.rollout.dev import Ship
    from fleet.rollout.link import Link

_HOW_TO = "see docs/how-to/see-each-save-on-the-robots.md"


@verb({"end": "bring the robots back to their release, and end"})
def dev(
    hosts: str = "all",
    end: bool = False,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
    stack: str = "",
) -> int:
    """Bring each saved file into the robots' containers.

    It goes on until Ctrl-C. `develop.watch` in the Compose file says which files, where to, and whether a service is
    restarted, a command run in it, or the image built and shipped. A robot that was away gets all changes when it is back.
    `fab status` shows that a robot is in dev; `fab ship`, `fab dev --end` and a reboot bring it back to a release.
    """
    fleet, robots = select(inventory, hosts)
    screen = Screen()
    if end:
        return _end(robots, stack=stack, dry=dry, json=json, screen=screen)
    if json:
        raise UsageError(
            "--json belongs to `fab dev --end`", cure="`fab status --json` says which robots are in dev"
        )
    whose.once(robots, among=fleet.robots.values())
    with Stacks(variables=build.variables_of) as stacks:
        found = stacks.of(robots, only=stack)
        screen.warnings(warnings_of(found))
        watched = {robot.name: _watched(robot, found[robot.name]) for robot in robots}
    if dry:
        screen.lines(_line(name, rule) for name, (_, rules) in watched.items() for rule in rules)
        return 0
    targets = {
        name: Target(stack=one.stack.name, rules=rules, request=_request(one))
        for name, (one, rules) in watched.items()
    }
    return _follow(robots, targets, stack=stack, screen=screen)


def _follow(robots: Sequence[Robot], targets: dict[str, Target], *, stack: str, screen: Screen) -> int:
    with contextlib.ExitStack() as kept, screen.progress() as progress:
        outcomes = follow(
            robots,
            targets,
            rebuild=partial(_rebuild, robots, stack, progress, kept),
            progress=progress,
            printer=screen.prefixed([robot.name for robot in robots]),
        )
    left = [one for one in outcomes if one.status == "skipped"]
    rest = tuple(one for one in outcomes if one.status != "skipped")
    if rest:
        screen.outcomes(rest)
    if left:
        names = ",".join(one.robot for one in left)
        screen.say(
            f"still in dev: {names}. `fab dev --end --hosts {names}` brings the release back, and so does `fab ship`"
        )
    return 0 if all(one.good for one in rest) else 1


def _end(robots: Sequence[Robot], *, stack: str, dry: bool, json: bool, screen: Screen) -> int:
    request = Request(by=whoami(), run=secrets.token_hex(8))

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        readiness.ready(facts, robot=robot)
        names = stacks_there(facts, only=stack)
        names = [
            name for name in names if name in facts.fleet.stacks and facts.fleet.stacks[name].dev
        ] or names[:1]
        return [dev_steps.end(robot=robot, stack=name, facts=facts, request=request) for name in names]

    return execute(robots, make, dry=dry, json=json, screen=screen)


def _watched(robot: Robot, stacks: Sequence[RobotStack]) -> tuple[RobotStack, tuple[watch.Rule, ...]]:
    """The stack of a robot that has `develop.watch`, and its rules."""
    found = [(one, rules) for one in stacks if (rules := watch.rules(one.stack, one.project))]
    if not found:
        names = ", ".join(one.stack.name for one in stacks)
        raise UsageError(
            f"{robot.name}: no service of {names or 'its stacks'} has `develop.watch`", cure=_HOW_TO
        )
    if len(found) > 1:
        names = ", ".join(one.stack.name for one, _ in found)
        raise UsageError(
            f"{robot.name} has several stacks with `develop.watch`", cure=f"say which with --stack: {names}"
        )
    return found[0]


def _line(name: str, rule: watch.Rule) -> str:
    to = f" -> {rule.service}:{rule.target}" if rule.syncs else f" -> {rule.service}"
    return f"{name}: {rule.action} {rule.path}{to}"


def _request(one: RobotStack) -> Request:
    return Request(by=whoami(), run=secrets.token_hex(8), wait=one.wait, settle=one.spec.settle)


def _options() -> Options:
    return Options(run=secrets.token_hex(8), wait=0, conflict="robot", keep=prune.KEEP, renamed=False)


def _rebuild(robots: Sequence[Robot], stack: str, progress: AnyProgress, kept: contextlib.ExitStack) -> Ship:
    """Build the images anew. Returns what ships them to one robot; until `fab dev` ends, ``kept`` keeps open what that needs."""
    stacks = kept.enter_context(Stacks(variables=build.variables_of))
    found = stacks.of(robots, only=stack)
    every = [(robot, one) for robot in robots for one in found[robot.name]]
    commands = build.commands_for(every, [], client=buildkit_client())
    builder.run_all(commands, watcher=build.Watcher(progress), memory=builder.free_memory())
    store = kept.enter_context(Store())
    sender = kept.enter_context(Sender.using(store, limiter=RateLimiter(None), by=whoami(), logins=login_of))
    releases = {robot.name: wanted.built(stacks, robot, found[robot.name], store) for robot in robots}
    planner = Planner(releases, sender, _options())
    ladder = [partial(planner.plans, strategy=strategy) for strategy in STRATEGIES]

    def ship(link: Link) -> Outcome:
        return bring(link, *ladder, open_feed=sender.open, progress=progress)

    return ship


VERBS = (dev,)
