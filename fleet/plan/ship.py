"""Which steps bring a robot to a release? Shipping a new one, and going back to an earlier one.

The order is that of a safe swap: everything that can fail without touching what runs comes first (the release's files,
the robot's own Compose reading them, the images and their proof); then the containers; then ``current``. When the
containers of a new release do not start, those of the previous one are started again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import NotReady
from fleet.plan import compose_steps, prune
from fleet.plan.step import Plan, Record, Step
from fleet.robot import history

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.plan.delivery import Delivery
    from fleet.robot.facts import Facts
    from fleet.robot.release import Release
from fleet.plan.readiness import ready

HEALTHY_WITHIN = 180
"""Seconds a release has to become healthy: a cold Pi needs 20, an emulated one on a busy desktop two minutes."""


def missing(release: Release, facts: Facts) -> tuple[Image, ...]:
    """The images of a release that the robot does not have."""
    return tuple(
        image for image in release.images if facts.fleet.images.get(image.shipped_as) != image.identity
    )


def plan(
    *, robot: Robot, release: Release, facts: Facts, delivery: Delivery, by: str, keep: int = prune.KEEP
) -> Plan:
    """The steps that bring a robot to ``release``; none if it runs it already.

    ``delivery`` brings the images that are `missing`. Only the ``keep`` newest releases stay on the robot.

    Raises:
        NotReady: the robot's Docker cannot be used, or the robot has another platform.

    """
    ready(facts, robot=robot)
    there = facts.fleet.current == release.id and facts.fleet.checksum == release.checksum
    others = tuple(container.name for container in facts.fleet.containers if container.stack != release.stack)
    if there and not delivery.steps and not others and _runs(release, facts):
        return Plan(robot=robot.name, summary=f"runs release {release.id}")
    images = tuple(image.shipped_as for image in release.images)
    steps = (
        compose_steps.write(release),
        _check(robot, release.id),
        *delivery.steps,
        *_clear(others),
        compose_steps.start(robot, release.id, wait=HEALTHY_WITHIN),
    )
    return Plan(
        robot=robot.name,
        summary=f"release {release.id}",
        steps=steps,
        explain=(compose_steps.last_words(robot, release.id),),
        recover=_previous(robot, facts, failed=release.id),
        afterwards=prune.after(facts, keep=keep, shipped=release.id, images=images),
        record=Record(verb="ship", release=release.id, by=by),
        forecast=delivery.forecast,
        transfer=delivery.transfer,
    )


def rollback(*, robot: Robot, facts: Facts, to: str, by: str) -> Plan:
    """The steps back to release ``to``; if that is empty, to the release that ran before the current one.

    Raises:
        NotReady: there is no such release on the robot.

    """
    ready(facts, robot=robot)
    target = to or _before(facts)
    if not target:
        raise NotReady(
            "there is no earlier release to go back to", cure=f"`fab history --hosts {robot.name}`"
        )
    if target not in facts.fleet.releases:
        cure = f"it has: {', '.join(facts.fleet.releases) or 'none'}"
        raise NotReady(f"release {target} is not on this robot", cure=cure)
    running = [container.release == target and container.healthy for container in facts.fleet.containers]
    if target == facts.fleet.current and running and all(running):
        return Plan(robot=robot.name, summary=f"runs release {target}")
    return Plan(
        robot=robot.name,
        summary=f"back to release {target}",
        steps=(_check(robot, target), compose_steps.start(robot, target, wait=HEALTHY_WITHIN)),
        explain=(compose_steps.last_words(robot, target),),
        recover=_previous(robot, facts, failed=target),
        record=Record(verb="rollback", release=target, by=by),
    )


def _runs(release: Release, facts: Facts) -> bool:
    healthy = {c.service for c in facts.fleet.containers if c.release == release.id and c.healthy}
    return healthy >= set(release.services)


def _check(robot: Robot, release: str) -> Step:
    return Step(
        title="let the robot's Compose check the release",
        argv=compose_steps.compose(robot, release, "config", "--quiet"),
        limit=30.0,
        harmless=True,
        resumes=True,
        cure="fix the Compose file or the robot's values in the inventory",
    )


def _clear(others: tuple[str, ...]) -> tuple[Step, ...]:
    """Remove the containers of a stack with another name: Compose would leave them running beside the new one."""
    if not others:
        return ()
    return (Step(title="remove the containers of another stack", argv=("docker", "rm", "--force", *others)),)


def _previous(robot: Robot, facts: Facts, *, failed: str) -> tuple[Step, ...]:
    """Start the previous release again; without one, stop the failed release, which would otherwise restart forever.

    A release that was current already is left to Docker: it may be healthy a minute later.
    """
    if facts.fleet.current == failed:
        return ()
    if facts.fleet.current not in facts.fleet.releases:
        return (compose_steps.stop(robot, failed),)
    return (compose_steps.start(robot, facts.fleet.current, wait=HEALTHY_WITHIN),)


def _before(facts: Facts) -> str:
    """The release that ran before the current one, from the history; "" if none of those is still on the robot."""
    ran = (
        event.release for event in reversed(history.history(facts.fleet.history)) if event.outcome == "done"
    )
    return next(
        (release for release in ran if release != facts.fleet.current and release in facts.fleet.releases), ""
    )
