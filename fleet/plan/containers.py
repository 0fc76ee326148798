"""Which steps start, stop, restart and remove what a robot has, and how are its logs read?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from fleet.errors import NotReady
from fleet.plan import compose_steps
from fleet.plan.readiness import ready
from fleet.plan.step import Plan, Step
from fleet.robot import paths

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.plan.compose_steps import Request
    from fleet.robot.facts import Facts, StackFacts

Verb = Literal["start", "stop", "restart"]


def plan(verb: Verb, *, robot: Robot, stack: str, facts: Facts, request: Request) -> Plan:
    """The steps that start, stop or restart the current release of a stack.

    Raises:
        NotReady: nothing was ever shipped to the robot, or its Docker cannot be used.

    """
    there = _current(facts, robot=robot, stack=stack)
    release = there.current
    if verb == "start" and there.running and not there.journal:
        return Plan(robot=robot.name, summary=f"release {release} runs")
    runs = any(one.state in ("running", "restarting") for one in there.containers)
    if verb == "stop" and not runs and (there.stopped or there.boot == "docker"):
        return Plan(robot=robot.name, summary=f"release {release} is stopped")
    return Plan(
        robot=robot.name,
        summary=f"{verb} release {release}",
        verb=verb,
        steps=(compose_steps.swap(verb, stack, release, seen=there.current, request=request),),
    )


def remove(*, robot: Robot, stack: str, facts: Facts, by: str, data: bool = False) -> Plan:
    """The steps that take a stack off a robot; its volumes stay, and so does its ``data`` unless that is to go.

    Raises:
        NotReady: its Docker cannot be used.

    """
    ready(facts, robot=robot)
    there = facts.fleet.stacks.get(stack)
    if there is None:
        return Plan(robot=robot.name, summary=f"has no stack {stack}")
    off = (compose_steps.remove(stack, by=by),) if there.releases or there.containers else ()
    deleted = _delete_data(stack, facts) if data and there.data != 0 else ()
    if not off and not deleted:
        nothing = f"has no data of stack {stack}" if data else f"has no stack {stack}"
        return Plan(robot=robot.name, summary=nothing)
    what = (f"stack {stack}" if off else "", f"data of stack {stack}" if deleted else "")
    return Plan(
        robot=robot.name,
        summary=f"{' and '.join(filter(None, what))} removed",
        verb="remove",
        steps=(*off, *deleted),
    )


def _delete_data(stack: str, facts: Facts) -> tuple[Step, ...]:
    """The step that deletes what a stack's containers have written: as root, because containers write as root."""
    root = ("sudo", "-n") if facts.login.sudo == "free" else ()
    folder = f"{facts.login.home}/{paths.data(stack)}"
    delivered = f"{facts.login.home}/{paths.stack(stack)}/delivered"
    return (
        Step(
            title=f"delete {folder}",
            argv=(*root, "rm", "-rf", "--one-file-system", folder, delivered),
            limit=600.0,
            resumes=True,
        ),
    )


def logs(
    *, robot: Robot, stack: str, facts: Facts, follow: bool, tail: str, since: str, service: str
) -> tuple[str, ...]:
    """The argv that prints the logs of a stack's current release: every service, or one.

    Raises:
        NotReady: as for `plan`.

    """
    there = _current(facts, robot=robot, stack=stack)
    options = ["logs", "--no-color", "--tail", tail]
    if len({container.service for container in there.containers}) < 2 or service:
        options += ["--no-log-prefix"]
    if since:
        options += ["--since", since]
    if follow:
        options += ["--follow"]
    argv = compose_steps.compose(stack, there.current, *options, *((service,) if service else ()))
    return compose_steps.until_closed(argv) if follow else argv


def _current(facts: Facts, *, robot: Robot, stack: str) -> StackFacts:
    ready(facts, robot=robot)
    there = facts.fleet.stacks.get(stack)
    if there is None or there.current not in there.releases:
        if facts.fleet.legacy:
            cure = f"`fab ship --hosts {robot.name}` takes them over"
            raise NotReady("its releases are of an earlier version of fleet", cure=cure)
        raise NotReady("nothing has been shipped to it", cure=f"`fab ship --hosts {robot.name}`")
    return there
