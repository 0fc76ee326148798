"""Whose robot is it? Two names for one computer, or one name for two, would let robots overwrite each other."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from fleet.config import yamlfile
from fleet.errors import ComposeError, FleetError, Refused, SelectionError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from fleet.cli.stacks import RobotStack
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts


def twins(robots: Sequence[Robot]) -> list[tuple[str, str]]:
    """Pairs of robots that the inventory gives one address, port and login."""
    seen: dict[tuple[object, ...], str] = {}
    pairs = []
    for robot in robots:
        place = (robot.address.lower(), robot.port, robot.user)
        if place in seen:
            pairs.append((seen[place], robot.name))
        seen.setdefault(place, robot.name)
    return pairs


def once(robots: Sequence[Robot], *, among: Iterable[Robot] = ()) -> None:
    """Refuse robots that the inventory gives the address of another: one of them, or ``among`` all that it has.

    Raises:
        SelectionError: a robot has the address of another.

    """
    names = {robot.name for robot in robots}
    everyone = tuple({robot.name: robot for robot in (*among, *robots)}.values())
    if pairs := [pair for pair in twins(everyone) if names & set(pair)]:
        one, other = pairs[0]
        address = next(robot.address for robot in everyone if robot.name == one)
        raise SelectionError(
            f"{one} and {other} have the same address, {address}: each would replace what the other runs",
            cure="correct the address of one of them, or remove it, in the inventory",
        )


def same_computers(seen: Mapping[str, Facts | FleetError]) -> list[tuple[str, str]]:
    """Pairs of robots that answered, and are one computer."""
    names: dict[str, str] = {}
    pairs = []
    for name, facts in seen.items():
        identity = "" if isinstance(facts, FleetError) else facts.host.identity
        if identity in names:
            pairs.append((names[identity], name))
        elif identity:
            names[identity] = name
    return pairs


class Machines:
    """The computers that were met in one run of a command; used by many threads."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}
        self._lock = threading.Lock()

    def claim(self, robot: Robot, facts: Facts, *, renamed: bool = False) -> None:
        """Take a computer for a robot.

        Raises:
            Refused: it is another robot of the same run, or what runs on it was shipped to a robot of another name.

        """
        identity = facts.host.identity
        with self._lock:
            other = self._names.setdefault(identity, robot.name) if identity else robot.name
        if other != robot.name:
            cure = "correct the address of one of them in the inventory"
            raise Refused(f"{robot.name} and {other} are the same computer", cure=cure)
        names = {one.robot for there in facts.fleet.stacks.values() for one in there.containers if one.robot}
        if names and robot.name not in names and not renamed:
            earlier = ", ".join(sorted(names))
            raise Refused(
                f"this computer was shipped to as {earlier}, and the inventory calls it {robot.name}",
                cure=f"correct the address; or, if the robot has a new name: fab ship --hosts {robot.name} --renamed",
            )


def same_stack(one: RobotStack, facts: Facts, *, robot: Robot) -> None:
    """Refuse a copy of a project under another folder name: it would start beside the first one, with empty volumes.

    Raises:
        Refused: the robot runs a stack with the same services under another name, and this one is named by its folder.

    """
    there = facts.fleet.stacks
    if one.stack.name in there or _is_named(one):
        return
    services = set(one.stack.services)
    for name, other in there.items():
        if other.services and set(other.services) == services:
            raise Refused(
                f"it runs these services as stack {name}, and this folder's name makes them stack {one.stack.name}",
                cure=f"write `name: {name}` into {one.project.files[0]} to go on with it, "
                f"or `name: {one.stack.name}` to have both on {robot.name}",
            )


def _is_named(one: RobotStack) -> bool:
    """Whether the project has a name of its own, rather than that of its folder."""
    if "COMPOSE_PROJECT_NAME" in one.environment:
        return True
    return any("name" in yamlfile.read(path, error=ComposeError).value for path in one.project.files)
