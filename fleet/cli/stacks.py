"""What do the robots of one command run? Compose is asked once for each different set of values."""

from __future__ import annotations

import contextlib
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from fleet.config import compose, docker_rules, project_files, stack
from fleet.config.project_files import File, ProjectFiles
from fleet.errors import InventoryError, Refused, UsageError
from fleet.plan.ship import HEALTHY_WITHIN
from fleet.robot import release
from fleet.ros import environment as ros

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from fleet.config.compose import Project
    from fleet.config.inventory import Robot, StackFiles
    from fleet.config.stack import Stack
    from fleet.images.image import Image
    from fleet.images.store import Store
    from fleet.robot.facts import Facts
    from fleet.robot.release import Release

AT_ONCE = 2 * (os.cpu_count() or 1)
"""Calls of Compose side by side: each is a process that reads files for a moment."""


@dataclass(frozen=True, kw_only=True)
class RobotStack:
    """One stack of one robot: where it is written, and what Compose says it is with this robot's values.

    ``warnings`` are Compose's.
    """

    spec: StackFiles
    project: Project
    stack: Stack
    environment: Mapping[str, str]
    warnings: tuple[str, ...]

    @property
    def wait(self) -> int:
        """Seconds in which its containers must become healthy."""
        return self.spec.wait or HEALTHY_WITHIN + round(self.stack.start_period)

    def with_images(self, others: Mapping[str, str]) -> RobotStack:
        """The same with ``others`` in place of the images that the Compose files name."""
        services = {
            name: replace(service, image=others.get(service.image, service.image))
            for name, service in self.stack.services.items()
        }
        return replace(self, stack=replace(self.stack, services=services))


class Stacks:
    """The stacks of some robots. Open it with ``with``: Compose's view of the projects is removed at the end."""

    def __init__(self, *, variables: Callable[[Project, Robot], Mapping[str, str]] | None = None) -> None:
        self._variables = variables or (lambda _project, _robot: {})
        self._open = contextlib.ExitStack()
        self._projects: dict[tuple[Path, ...], Project] = {}
        self._files: dict[tuple[object, ...], ProjectFiles] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def of(self, robots: Sequence[Robot], *, only: str = "") -> dict[str, tuple[RobotStack, ...]]:
        """The stacks of each robot, by its name; of all, or ``only`` the one with that name.

        Raises:
            ComposeError: Compose refuses one.
            UsageError: no robot has a stack of the name ``only``, or two of one robot have the same name.

        """
        with ThreadPoolExecutor(AT_ONCE) as pool:
            wanted = [(robot, spec) for robot in robots for spec in robot.stacks]
            for _, spec in wanted:
                self._project(spec)
            read = pool.map(lambda pair: self._read(*pair), wanted)
            found: dict[str, list[RobotStack]] = {robot.name: [] for robot in robots}
            for (robot, _), one in zip(wanted, read, strict=True):
                found[robot.name].append(one)
        return {name: _chosen(name, stacks, only=only) for name, stacks in found.items()}

    def release(self, robot: Robot, one: RobotStack, *, images: Mapping[str, Image]) -> Release:
        """The release of a stack that a robot is to run."""
        key = (one.spec, tuple(one.stack.mounts), tuple(sorted(robot.files.items())))
        if key not in self._files:
            given = {f"files/{name}": _given(path) for name, path in robot.files.items()}
            self._files[key] = project_files.collect(
                one.stack, one.project, allowed=one.spec.outside, given=given
            )
        return release.compose(
            robot=robot.name,
            stack=one.stack,
            project=one.project,
            files=self._files[key],
            images=images,
            boot=robot.boot,
        )

    def releases(
        self, robot: Robot, stacks: Sequence[RobotStack], store: Store
    ) -> list[tuple[RobotStack, Release]]:
        """The release of each of a robot's stacks, with the images of this computer."""
        return [(one, self.release(robot, one, images=images_of(one, robot, store))) for one in stacks]

    def _project(self, spec: StackFiles) -> Project:
        if spec.files not in self._projects:
            self._projects[spec.files] = self._open.enter_context(compose.opened(spec.files))
        return self._projects[spec.files]

    def _read(self, robot: Robot, spec: StackFiles) -> RobotStack:
        project = self._project(spec)
        environment = {**environment_of(robot), **self._variables(project, robot)}
        resolved = compose.resolve(project, environment=environment)
        docker_rules.check(resolved, project)
        read = stack.read(resolved, project)
        return RobotStack(
            spec=spec,
            project=project,
            stack=read,
            environment=environment,
            warnings=resolved.warnings,
        )


def environment_of(robot: Robot) -> dict[str, str]:
    """The values of a robot for its stacks: the inventory's, its ROS settings, and what the inventory passes on by name.

    Raises:
        UsageError: the inventory passes on a variable that this shell does not have.

    """
    missing = [name for name in robot.pass_environment if name not in os.environ]
    if missing:
        raise UsageError(
            f"the inventory passes {', '.join(missing)} of your shell on to {robot.name}, and it is not set",
            cure=f"export {missing[0]}=..., or remove it from `pass_environment`",
        )
    passed = {name: os.environ[name] for name in robot.pass_environment}
    user = {"USER": robot.user} if robot.user else {}
    return {**user, **passed, **robot.environment, **ros.environment(robot), "FLEET_ROBOT": robot.name}


def _chosen(robot: str, stacks: Sequence[RobotStack], *, only: str) -> tuple[RobotStack, ...]:
    names = [one.stack.name for one in stacks]
    if twice := next((name for name in names if names.count(name) > 1), ""):
        raise UsageError(
            f"{robot} has two stacks with the name {twice}",
            cure="give each Compose file a `name:` of its own",
        )
    if only and only not in names:
        raise UsageError(f"{robot} has no stack {only}", cure=f"it has: {', '.join(names)}")
    return tuple(one for one in stacks if only in ("", one.stack.name))


def _given(path: Path) -> File:
    try:
        return File(data=path.read_bytes(), mode=0o755 if path.stat().st_mode & 0o100 else 0o644)
    except OSError as problem:
        raise InventoryError(
            f"cannot read {path}: {problem.strerror}", cure="see `files:` in the inventory"
        ) from problem


def stacks_there(facts: Facts, *, only: str, alone: bool = False) -> list[str]:
    """The stacks that a robot has, or ``only`` the one with that name; ``alone``: it must be one.

    Raises:
        Refused: the robot does not have it.

    """
    names = [name for name, one in facts.fleet.stacks.items() if one.releases or one.containers]
    if only and only not in names:
        raise Refused(f"it has no stack {only}", cure=f"it has: {', '.join(names) or 'none'}")
    if alone and not only and len(names) > 1:
        raise Refused("it has several stacks", cure=f"say which with --stack: {', '.join(names)}")
    return [only] if only else names or [""]


def warnings_of(stacks: Mapping[str, Sequence[RobotStack]]) -> dict[str, list[str]]:
    """Compose's warnings about the stacks of each robot, by its name."""
    return {name: [text for one in ones for text in one.warnings] for name, ones in stacks.items()}


def images_of(one: RobotStack, robot: Robot, store: Store) -> dict[str, Image]:
    """The local image of each service of a stack, for a robot."""
    return {
        service.name: store.find(service.image, service.platform or robot.platform)
        for service in one.stack.services.values()
    }
