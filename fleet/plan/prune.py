"""Which old releases and images may be removed from a robot?

The current release, the one before it, and the images of releases that stay are never removed. Images that fleet did not
send are not touched.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from fleet.plan.step import Plan, Record, Step
from fleet.robot import history, paths
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable

    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts

KEEP = 3
"""Releases that stay on a robot."""

LEAST = 2
"""The current release, and the one to go back to."""

_OURS = re.compile(r".+:fleet-[0-9a-f]{12}")


def plan(*, robot: Robot, facts: Facts, keep: int, by: str) -> Plan:
    """The steps that leave a robot with its ``keep`` newest releases."""
    steps = after(facts, keep=keep)
    if not steps:
        return Plan(robot=robot.name, summary=f"nothing is older than its newest {max(keep, LEAST)} releases")
    return Plan(
        robot=robot.name,
        summary=" and ".join(step.title for step in steps),
        steps=steps,
        forecast=_frees(steps, facts),
        record=Record(verb="prune", release=facts.fleet.current, by=by),
    )


def _frees(steps: Iterable[Step], facts: Facts) -> str:
    """The most that the steps free. Docker knows the exact size only after measuring the disk, minutes on an SD card."""
    size = sum(facts.fleet.image_store.sizes.get(name, 0) for step in steps for name in step.argv)
    return f"frees {human_bytes(size)} at most: layers that other images share stay" if size else ""


def after(facts: Facts, *, keep: int, shipped: str = "", images: Iterable[str] = ()) -> tuple[Step, ...]:
    """The steps that remove old releases. ``shipped`` is a release that became current since the probe, with its ``images``."""
    ranked = list(dict.fromkeys(filter(None, (shipped, facts.fleet.current, *_newest_first(facts)))))
    stay = ranked[: max(keep, LEAST)]
    gone = sorted(set(facts.fleet.releases) - set(stay))
    pins = {**facts.fleet.image_store.pins, **({shipped: tuple(images)} if shipped else {})}
    old: list[str] = []
    if all(release in pins for release in stay if release in {*facts.fleet.releases, shipped}):
        needed = {name for release in stay for name in pins.get(release, ())}
        old = sorted(name for name in facts.fleet.images if _OURS.fullmatch(name) and name not in needed)
    return (*_forget(gone), *_remove(old))


def _newest_first(facts: Facts) -> tuple[str, ...]:
    """Releases that have run, newest first; then those that never ran, in no particular order."""
    ran = [event.release for event in history.history(facts.fleet.history) if event.outcome == "done"]
    return tuple(
        release for release in (*reversed(ran), *facts.fleet.releases) if release in facts.fleet.releases
    )


def _forget(releases: list[str]) -> tuple[Step, ...]:
    if not releases:
        return ()
    folders = (paths.folder(release) for release in releases)
    return (Step(title=f"remove {_count(releases, 'release')}", argv=("rm", "-rf", *folders), harmless=True),)


def _remove(images: list[str]) -> tuple[Step, ...]:
    if not images:
        return ()
    receipts = (f"{paths.RECEIPTS}/{name.rpartition(':fleet-')[2]}" for name in images)
    return (
        Step(
            title=f"remove {_count(images, 'image')}",
            argv=("docker", "image", "rm", *images),
            limit=120.0,
            harmless=True,
        ),
        Step(title="remove their receipts", argv=("rm", "-f", *receipts), harmless=True),
    )


def _count(things: list[str], name: str) -> str:
    return f"{len(things)} old {name}{'s' * (len(things) != 1)}"
