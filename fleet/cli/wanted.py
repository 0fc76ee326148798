"""What shall the robots of one `fab ship` run: releases of this computer's projects and images, or those of a bundle?"""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.bundle import read as bundles
from fleet.cli import doubts
from fleet.cli.beside import beside
from fleet.cli.build import Watcher
from fleet.cli.stacks import Stacks, warnings_of
from fleet.errors import UsageError
from fleet.images import builder, registry_images
from fleet.images.store import Store

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

    from fleet.bundle.read import BundleReader
    from fleet.cli.console import Screen
    from fleet.cli.stacks import RobotStack
    from fleet.config.inventory import Robot
    from fleet.robot.release import Release
    from fleet.transfer.sender import Images

    Releases = dict[str, list["Wanted"]]


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A release that a robot shall run, and its stack's seconds. ``project`` is None for a release out of a bundle."""

    release: Release
    wait: int
    settle: int
    project: RobotStack | None = None


@contextlib.contextmanager
def opened(
    robots: Sequence[Robot], *, out_of: str, only: str, screen: Screen, dry: bool = False
) -> Generator[tuple[Images, Releases]]:
    """Where the images are, and what each robot shall run, by its name.

    ``out_of`` is a bundle, or images of a registry, which are pulled unless it is ``dry``; without it, the images are those of
    this computer.

    Raises:
        UsageError, DesktopError: as the bundle, Compose and Docker say.

    """
    from_registry = registry_images.parse(out_of) if registry_images.meant(out_of) else ()
    with contextlib.ExitStack() as stack:
        if out_of and not from_registry:
            reader = stack.enter_context(bundles.opened(Path(out_of).expanduser()))
            yield reader, {robot.name: bundled(reader, robot, only=only) for robot in robots}
            return
        store_opened = stack.enter_context(beside(Store))
        stacks = stack.enter_context(Stacks())
        found = stacks.of(robots, only=only)
        screen.warnings(warnings_of(found))
        found = _pulled(from_registry, robots, found, screen=screen, dry=dry) if from_registry else found
        store = stack.enter_context(store_opened())
        doubts.tell(robots, found, store, screen=screen)
        yield store, {robot.name: built(stacks, robot, found[robot.name], store) for robot in robots}


def _pulled(
    names: Sequence[str],
    robots: Sequence[Robot],
    found: Mapping[str, Sequence[RobotStack]],
    *,
    screen: Screen,
    dry: bool,
) -> dict[str, tuple[RobotStack, ...]]:
    """Bring a registry's images here; return the stacks with them in place of those that the Compose files name.

    Raises:
        UsageError: an image stands for none of them, or is not here and it is ``dry``.
        DesktopError: one cannot be pulled.

    """
    platforms: dict[str, set[str]] = {}
    for robot in robots:
        for service in (service for one in found[robot.name] for service in one.stack.services.values()):
            platforms.setdefault(service.image, set()).add(service.platform or robot.platform)
    pins = registry_images.pins(names, wanted=platforms)
    commands = registry_images.commands(pins, platforms)
    if dry and (missing := next((one for one in commands if one.pulls and not builder.here(one)), None)):
        raise UsageError(
            f"{missing.pulls} for {missing.platform} is not on this computer, so nothing can be said of it",
            cure=f"`{shlex.join(missing.argv)}`, or run the command without --dry: it pulls it first",
        )
    if commands:
        with screen.progress() as progress:
            builder.run_all(commands, watcher=Watcher(progress), memory=builder.free_memory())
    local = {wanted: registry_images.local(wanted, name) for wanted, name in pins.items()}
    return {name: tuple(one.with_images(local) for one in stacks) for name, stacks in found.items()}


def built(stacks: Stacks, robot: Robot, found: Sequence[RobotStack], store: Store) -> list[Wanted]:
    """What a robot shall run, with the images of this computer."""
    return [
        Wanted(release=release, wait=one.wait, settle=one.spec.settle, project=one)
        for one, release in stacks.releases(robot, found, store)
    ]


def bundled(reader: BundleReader, robot: Robot, *, only: str) -> list[Wanted]:
    """What a robot shall run, out of a bundle. Raises `UsageError` if that has nothing for it."""
    stacks = reader.bundle.robot(robot.name).stacks
    if only and only not in {one.name for one in stacks}:
        cure = f"it has: {', '.join(one.name for one in stacks)}"
        raise UsageError(f"the bundle has no stack {only} for {robot.name}", cure=cure)
    return [
        Wanted(release=reader.release(robot.name, one), wait=one.wait, settle=one.settle)
        for one in stacks
        if only in ("", one.name)
    ]
