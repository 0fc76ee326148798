"""Which steps start, stop and restart what a robot has, and how are its logs read?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from fleet.errors import NotReady
from fleet.plan import compose_steps
from fleet.plan.readiness import ready
from fleet.plan.ship import HEALTHY_WITHIN
from fleet.plan.step import Plan, Record, Step

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts

Verb = Literal["start", "stop", "restart"]


def plan(verb: Verb, *, robot: Robot, facts: Facts, by: str) -> Plan:
    """The steps that start, stop or restart the current release.

    Raises:
        NotReady: nothing was ever shipped to the robot, or its Docker cannot be used.

    """
    release = _current(facts, robot=robot)
    running = [container for container in facts.fleet.containers if container.state == "running"]
    good = [container.healthy and container.release == release for container in facts.fleet.containers]
    if verb == "start" and good and all(good):
        return Plan(robot=robot.name, summary=f"release {release} runs")
    if verb == "stop" and not running:
        return Plan(robot=robot.name, summary=f"release {release} is stopped")
    return Plan(
        robot=robot.name,
        summary=f"{verb} release {release}",
        steps=_steps(verb, robot, release),
        explain=(compose_steps.last_words(robot, release),) if verb != "stop" else (),
        record=Record(verb=verb, release=release, by=by),
    )


def logs(*, robot: Robot, facts: Facts, follow: bool, tail: str, since: str, service: str) -> tuple[str, ...]:
    """The argv that prints the current release's logs: every service, or one.

    Raises:
        NotReady: as for `plan`.

    """
    release = _current(facts, robot=robot)
    options = ["logs", "--no-color", "--tail", tail]
    if len({container.service for container in facts.fleet.containers}) < 2 or service:
        options += ["--no-log-prefix"]
    if since:
        options += ["--since", since]
    if follow:
        options += ["--follow"]
    argv = compose_steps.compose(robot, release, *options, *((service,) if service else ()))
    return compose_steps.until_closed(argv) if follow else argv


def _current(facts: Facts, *, robot: Robot) -> str:
    ready(facts, robot=robot)
    if facts.fleet.current not in facts.fleet.releases:
        raise NotReady("nothing has been shipped to it", cure=f"`fab ship --hosts {robot.name}`")
    return facts.fleet.current


def _steps(verb: Verb, robot: Robot, release: str) -> tuple[Step, ...]:
    match verb:
        case "start":
            return (compose_steps.start(robot, release, wait=HEALTHY_WITHIN),)
        case "stop":
            return (compose_steps.stop(robot, release),)
        case "restart":
            again = Step(
                title=f"restart release {release}",
                argv=compose_steps.compose(robot, release, "restart"),
                limit=90.0,
            )
            return (again, compose_steps.start(robot, release, wait=HEALTHY_WITHIN))
