"""Which commands put a stack of a robot into dev, bring files into its containers, and end it?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet import onboard
from fleet.plan import compose_steps
from fleet.plan.readiness import ready
from fleet.plan.step import Plan
from fleet.robot.facts import StackFacts

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.config.watch import Hook
    from fleet.plan.compose_steps import Request
    from fleet.robot.facts import Facts


def hold(stack: str, release: str, *, session: str, request: Request) -> tuple[str, ...]:
    """The argv that keeps a stack in dev while the desktop is connected; its standard input stays open."""
    numbers = (str(request.wait), str(request.settle))
    scripts = (onboard.text("detach.sh"), onboard.text("swap.sh"))
    argv = (*_script("dev_hold.sh"), stack, release, request.by, session, *scripts, *numbers)
    return compose_steps.until_closed(argv)


def sync(
    stack: str, *, session: str, name: str, size: int, offset: int, restart: tuple[str, ...]
) -> tuple[str, ...]:
    """The argv that takes an upload from byte ``offset`` on, and restarts services; ``name`` is the upload's SHA-256."""
    return (*_script("dev_sync.sh"), stack, session, name, str(size), str(offset), *restart)


def hook(stack: str, release: str, service: str, one: Hook) -> tuple[str, ...]:
    """The argv of a command in the container of a service."""
    options = [
        *(("--user", one.user) if one.user else ()),
        *(("--workdir", one.folder) if one.folder else ()),
        *(("--privileged",) if one.privileged else ()),
        *(word for name, value in one.environment for word in ("--env", f"{name}={value}")),
    ]
    return compose_steps.compose(stack, release, "exec", "-T", *options, service, *one.command)


def logs(stack: str, release: str, *, since: str) -> tuple[str, ...]:
    """The argv that prints lines of all containers, from a time of the robot's on, until its standard input closes."""
    options = ("--follow", "--no-color", "--no-log-prefix", "--since", since)
    return compose_steps.until_closed(compose_steps.compose(stack, release, "logs", *options))


def end(*, robot: Robot, stack: str, facts: Facts, request: Request) -> Plan:
    """The steps that bring a stack in dev back to its current release; none if it is not in dev.

    Raises:
        NotReady: its Docker cannot be used.

    """
    ready(facts, robot=robot)
    there = facts.fleet.stacks.get(stack, StackFacts())
    if there.dev is None:
        return Plan(
            robot=robot.name,
            summary=f"runs release {there.current}" if there.current else "nothing is in dev",
        )
    return Plan(
        robot=robot.name,
        summary=f"back at release {there.current}",
        verb="dev",
        steps=(compose_steps.swap("dev", stack, there.current, seen=there.current, request=request),),
    )


def _script(name: str) -> tuple[str, ...]:
    return ("sh", "-c", onboard.text(name), name.removesuffix(".sh"))
