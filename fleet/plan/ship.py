"""Which steps bring a robot to a release? Shipping a new one, and going back to an earlier one.

The order is that of a safe swap: everything that can fail without touching what runs comes first (the release's files,
the robot's own Compose reading them, the images and their proof); then the swap, which is the robot's own work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import NotReady, Refused
from fleet.plan import claims, compose_steps, hardware, prune
from fleet.plan.readiness import ready
from fleet.plan.step import Plan, Step
from fleet.robot import history
from fleet.robot.facts import StackFacts

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.plan.compose_steps import Request
    from fleet.plan.delivery import Delivery
    from fleet.robot.facts import Facts
    from fleet.robot.release import Release

HEALTHY_WITHIN = 180
"""Seconds a release has to become healthy: a cold Pi needs 20, an emulated one on a busy desktop two minutes."""


def missing(release: Release, facts: Facts) -> tuple[Image, ...]:
    """The images of a release that a robot does not have."""
    return tuple(
        image for image in release.images if facts.fleet.images.get(image.shipped_as) != image.identity
    )


def plan(
    *,
    robot: Robot,
    release: Release,
    facts: Facts,
    delivery: Delivery,
    request: Request,
    keep: int = prune.KEEP,
) -> Plan:
    """The steps from what the robot has (``facts``) to ``release``; none if it runs it already.

    ``delivery`` brings the images that are `missing`. Afterwards the ``keep`` newest releases stay.

    Raises:
        NotReady: the robot cannot take it: no usable Docker, another architecture, a missing device, a port that something else has.

    """
    ready(facts, robot=robot)
    _check_boot(release, facts, robot=robot)
    there = facts.fleet.stacks.get(release.stack, StackFacts())
    if not delivery.steps and _runs(release, there, facts=facts, request=request):
        return Plan(robot=robot.name, summary=f"runs release {release.id}")
    hardware.check(robot, release, facts)
    claims.check(release, facts.fleet.claims)
    legacy, images = facts.fleet.legacy, tuple(image.shipped_as for image in release.images)
    seen = compose_steps.UNKNOWN if legacy else there.current
    return Plan(
        robot=robot.name,
        summary=f"release {release.id}",
        verb="ship",
        steps=(
            *((compose_steps.adopt(legacy),) if legacy else ()),
            compose_steps.write(release, home=facts.login.home),
            _check(release.stack, release.id),
            *delivery.steps,
            compose_steps.swap("ship", release.stack, release.id, seen=seen, request=request),
        ),
        afterwards=prune.after(facts, stack=release.stack, keep=keep, shipped=release.id, images=images),
        forecast=delivery.forecast,
        transfer=delivery.transfer,
    )


def _check_boot(release: Release, facts: Facts, *, robot: Robot) -> None:
    """Refuse a release that nobody would start at power-on."""
    match release.boot, facts.docker.boot_unit:
        case "systemd", "no systemd":
            raise NotReady(
                "it has no systemd to start the stack", cure=f"set `boot: docker` for {robot.name}"
            )
        case "systemd", "":
            what = "systemd shall start the stack, and fleet-boot.service is not installed there"
            raise NotReady(what, cure=f"`fab provision --hosts {robot.name}`")
        case _:
            return


def _runs(release: Release, there: StackFacts, *, facts: Facts, request: Request) -> bool:
    """Whether a robot runs a release, and nothing is to be decided or finished there."""
    written = (there.current, there.checksum) == (release.id, release.checksum(facts.login.home))
    # Whether a file that both sides have changed is still undecided, only the robot knows.
    decides = bool(release.seeds) and request.conflict == "desktop"
    return written and there.running and not there.journal and not there.dev and not decides


def rollback(*, robot: Robot, stack: str, facts: Facts, to: str, request: Request) -> Plan:
    """The steps back to release ``to``, or to the one that ran before the current one if ``to`` is empty.

    Raises:
        NotReady: there is no such release on the robot.

    """
    ready(facts, robot=robot)
    there = facts.fleet.stacks.get(stack, StackFacts())
    target = to or before(there)
    if not target:
        raise NotReady(
            "there is no earlier release to go back to", cure=f"`fab history --hosts {robot.name}` lists them"
        )
    if target not in there.releases:
        cure = f"it has: {', '.join(there.releases) or 'none'}"
        raise Refused(f"release {target} is not on this robot", cure=cure)
    if target == there.current and there.running and not there.journal and not there.dev:
        return Plan(robot=robot.name, summary=f"runs release {target}")
    return Plan(
        robot=robot.name,
        summary=f"back to release {target}",
        verb="rollback",
        steps=(
            _check(stack, target),
            compose_steps.swap("rollback", stack, target, seen=there.current, request=request),
        ),
    )


def before(there: StackFacts) -> str:
    """The release that ran before the current one, as the history says; "" if none of those is still there."""
    ran = (event.release for event in reversed(history.history(there.history)) if event.outcome == "done")
    return next((release for release in ran if release != there.current and release in there.releases), "")


def _check(stack: str, release: str) -> Step:
    return Step(
        title="let the robot's Compose check the release",
        argv=compose_steps.compose(stack, release, "config", "--quiet"),
        limit=30.0,
        harmless=True,
        resumes=True,
        cure="the robot's Compose may be too old for the file: `fab status` shows its version",
    )
