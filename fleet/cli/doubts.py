"""Which stacks would start well, and not work? They are warned about, or refused if the inventory says so (`ros: strict`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import UsageError
from fleet.ros import middleware, silent_stack, unused_settings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.cli.console import Screen
    from fleet.cli.stacks import RobotStack
    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.images.store import Store

    Doubts = Mapping[str, Sequence[str]]
    """Sentences about the stacks of each robot, by its name."""


def of_stacks(robots: Sequence[Robot], stacks: Mapping[str, Sequence[RobotStack]]) -> Doubts:
    """What the Compose files tell."""
    return {
        robot.name: [
            text
            for one in stacks[robot.name]
            for text in (
                *silent_stack.warnings(one.stack, version=robot.ros.version),
                *unused_settings.warnings(robot, one.stack),
            )
        ]
        for robot in robots
    }


def of_images(robots: Sequence[Robot], stacks: Mapping[str, Sequence[RobotStack]], store: Store) -> Doubts:
    """What the images of this computer tell. Each is looked into once. Raises `ImageError` if one is missing."""
    there: dict[str, frozenset[str]] = {}

    def middlewares(image: Image) -> frozenset[str]:
        if image.identity not in there:
            folders = middleware.folders(store.environment(image))
            there[image.identity] = frozenset().union(*(store.names_in(image, folder) for folder in folders))
        return there[image.identity]

    found: dict[str, list[str]] = {robot.name: [] for robot in robots}
    for robot in robots:
        for one in stacks[robot.name]:
            for name, wanted in _wanted(one).items():
                service = one.stack.services[name]
                image = store.find(service.image, service.platform or robot.platform)
                text = middleware.warning(wanted, service=name, image=service.image, there=middlewares(image))
                found[robot.name] += [text] if text else []
    return found


def _wanted(one: RobotStack) -> dict[str, str]:
    """The middleware that each service asks for, if it does."""
    services = one.stack.model.get("services") or {}
    asked = {
        name: (value.get("environment") or {}).get("RMW_IMPLEMENTATION") for name, value in services.items()
    }
    return {name: str(wanted) for name, wanted in asked.items() if wanted and name in one.stack.services}


def tell(
    robots: Sequence[Robot],
    stacks: Mapping[str, Sequence[RobotStack]],
    store: Store | None = None,
    *,
    screen: Screen,
) -> None:
    """Refuse what the inventory wants refused, and warn about the rest; about images only with a ``store``.

    Raises `UsageError`, or `ImageError` if an image is missing.
    """
    for about in (of_stacks(robots, stacks), of_images(robots, stacks, store) if store else {}):
        refuse(robots, about)
        screen.warnings(about)


def refuse(robots: Sequence[Robot], doubts: Doubts) -> None:
    """Raise `UsageError` if there are doubts about a stack of a robot that is strict about them."""
    strict = {
        robot.name: doubts[robot.name] for robot in robots if robot.ros.strict and doubts.get(robot.name)
    }
    for name, (first, *_) in strict.items():
        more = f" (and {len(strict) - 1} more robots)" if len(strict) > 1 else ""
        what, _, cure = first.partition("; ")
        raise UsageError(
            f"{name}{more}: {what}", cure=f"{cure}; or remove `strict:` under `ros:`, for a warning only"
        )
