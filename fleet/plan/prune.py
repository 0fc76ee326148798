"""Which old releases and images may be removed from a robot?

The current release, the one before it, and the images of releases that stay are never removed. Images that fleet did not
send are not touched.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.plan.step import Plan, Step
from fleet.robot import history
from fleet.robot.facts import StackFacts
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts

KEEP = 3
"""Releases that stay on a robot."""

LEAST = 2
"""The current release, and the one to go back to."""

_OURS = re.compile(r".+:fleet-[0-9a-f]{12}")

YOUNG = 3600
"""Seconds for which a release stays that another desktop has written to start it."""


def plan(*, robot: Robot, facts: Facts, stacks: Iterable[str], keep: int) -> Plan:
    """The steps that leave each of a robot's ``stacks`` with its ``keep`` newest releases."""
    steps = (*(step for stack in stacks for step in _old(facts, stack=stack, keep=keep)), *_sweep(facts))
    if not steps:
        return Plan(robot=robot.name, summary=f"nothing is older than its newest {max(keep, LEAST)} releases")
    return Plan(
        robot=robot.name,
        summary=" and ".join(step.title for step in steps),
        verb="prune",
        steps=steps,
        forecast=_frees(steps, facts),
    )


def _frees(steps: Iterable[Step], facts: Facts) -> str:
    """The most that the steps free. Docker knows the exact size only after measuring the disk, minutes on an SD card."""
    size = sum(facts.fleet.image_store.sizes.get(name, 0) for step in steps for name in step.argv)
    return f"frees {human_bytes(size)} at most: layers that other images share stay" if size else ""


def after(
    facts: Facts, *, stack: str, keep: int, shipped: str = "", images: Iterable[str] = ()
) -> tuple[Step, ...]:
    """What a ship of a release of a stack removes in the end: as `plan` for this stack.

    ``shipped`` became current since the probe, with its ``images``.
    """
    return (*_old(facts, stack=stack, keep=keep, shipped=shipped, images=images), *_sweep(facts))


def _sweep(facts: Facts) -> tuple[Step, ...]:
    """The step that removes what interrupted commands have left."""
    names = facts.fleet.image_store.leftovers
    if not names:
        return ()
    shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    return (
        Step(
            title=f"remove what interrupted commands have left ({shown})",
            argv=("sh", "-c", onboard.text("sweep.sh"), "sweep", *names),
            limit=300.0,
            harmless=True,
        ),
    )


def _old(
    facts: Facts, *, stack: str, keep: int, shipped: str = "", images: Iterable[str] = ()
) -> tuple[Step, ...]:
    """The step that removes a stack's old releases, and the images that no release of any stack needs.

    ``shipped`` is a release that became current since the probe, with its ``images``.
    """
    there = facts.fleet.stacks.get(stack, StackFacts())
    ranked = list(dict.fromkeys(filter(None, (shipped, there.current, *_newest_first(there)))))
    stay = {
        (stack, release) for release in ranked[: max(keep, LEAST)] if release in {*there.releases, shipped}
    }
    stay |= {
        (name, release)
        for name, other in facts.fleet.stacks.items()
        if name != stack
        for release in other.releases
    }
    gone = sorted(set(there.releases) - {release for name, release in stay if name == stack})
    old = _unneeded(stay, facts, new={(stack, shipped): tuple(images)} if shipped else {})
    if not gone and not old:
        return ()
    counts = (_count(gone, "release") if gone else "", _count(old, "image") if old else "")
    return (
        Step(
            title=f"remove {' and '.join(filter(None, counts))}",
            argv=(
                *("sh", "-c", onboard.text("remove_releases.sh"), "remove_releases"),
                *(stack, str(YOUNG), *gone, "--", *old),
            ),
            limit=300.0,
            harmless=True,
        ),
    )


def _unneeded(
    stay: Iterable[tuple[str, str]], facts: Facts, *, new: Mapping[tuple[str, str], tuple[str, ...]]
) -> list[str]:
    """The images that no release which stays runs; none if one of these does not say which it runs."""
    pins = {**facts.fleet.image_store.pins, **{"/".join(release): names for release, names in new.items()}}
    staying = ["/".join(release) for release in stay]
    if not all(release in pins for release in staying):
        return []
    needed = {name for release in staying for name in pins[release]}
    return sorted(name for name in facts.fleet.images if _OURS.fullmatch(name) and name not in needed)


def _newest_first(there: StackFacts) -> tuple[str, ...]:
    """Releases that have run, newest first; then those that never ran, in no particular order."""
    ran = [event.release for event in history.history(there.history) if event.outcome == "done"]
    return tuple(release for release in (*reversed(ran), *there.releases) if release in there.releases)


def _count(things: list[str], name: str) -> str:
    return f"{len(things)} old {name}{'s' * (len(things) != 1)}"
