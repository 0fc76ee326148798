"""Which verbs look for robots in the local network? ``fab find`` and ``fab await``."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from fleet.cli import program, selection
from fleet.cli.console import Screen
from fleet.cli.verb import verb
from fleet.errors import FleetError
from fleet.rollout import arrival, sighting
from fleet.rollout.link import Link

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from fleet.config.inventory import Robot
    from fleet.rollout.sighting import Candidate, Sighting

COLUMNS = ("address", "name", "robot", "computer", "host key")

_MODEL = "tr -d '\\000' </proc/device-tree/model || cat /sys/class/dmi/id/product_name"


_SCAN = "try each address of this computer's networks too, of those with at most 256 addresses"


@verb({"timeout": "seconds to wait; default: 300", "scan": _SCAN}, name="await", looks=True)
def await_(
    hosts: str = "all", timeout: int = 300, scan: bool = False, json: bool = False, inventory: str = ""
) -> int:
    """Wait until robots have come up, and say where.

    It waits until each robot lets you in and its first boot is over; restarts and lost connections do not end the wait. A
    robot that is not at its address is looked for by its name in the local network, and by its host key among the neighbours
    of this computer.
    """
    screen, robots = Screen(), selection.select(inventory, hosts)[1]
    with screen.progress() as progress:
        outcomes = arrival.wait(robots, timeout=timeout, scan=scan, progress=progress)
    return screen.result(outcomes, json=json)


@verb({"scan": _SCAN}, looks=True)
def find(scan: bool = False, json: bool = False, inventory: str = "") -> None:
    """Look for robots in the local network.

    It asks who announces itself (mDNS) and the neighbours that this computer knows, without logging in, at port 22 and the
    ports of your robots. A robot of the inventory is recognised by its host key, also at another address. Each computer is
    shown once, with all its addresses. For other computers it prints lines for the inventory.
    """
    screen = Screen()
    fleet = selection.load(inventory) if inventory or selection.found() else None
    robots = tuple(fleet.robots.values()) if fleet else ()
    screen.say("looking around" + (", at each address" if scan else ""))
    register = sighting.register(robots)
    found = sighting.candidates(
        also=register.places,
        ports=register.ports,
        scan=scan,
        on_problem=lambda problem: screen.say(f"note: {problem}"),
    )
    seen = sorted(
        sighting.computers(sighting.sight(found, like=_anybody(robots), register=register)),
        key=lambda one: (not one.robot, not one.candidate.likely, one.candidate.order),
    )
    models = _models(seen, robots)
    if json:
        screen.json([record(one, model=models.get(one.robot, "")) for one in seen])
        return
    screen.table(COLUMNS, [_row(one, models.get(one.robot, "")) for one in seen])
    for line in _advice(seen, robots, scan=scan):
        screen.say(program.typed(line))


def record(one: Sighting, *, model: str) -> dict[str, str | int | list[str]]:
    """Return what programs get about a computer."""
    where = one.candidate
    return {
        "address": where.address,
        "port": where.port,
        "also": [other.where for other in one.also],
        "name": where.name,
        "maker": where.maker,
        "system": where.system,
        "model": model,
        "robot": one.robot,
        "expected": one.expected,
        "here": one.here,
        "key": one.key,
        "fingerprint": one.fingerprint,
    }


def _anybody(robots: Sequence[Robot]) -> Robot:
    """Whom to ask for a host key as: no jump host, no port of its own."""
    from fleet.config.inventory import Robot  # noqa: PLC0415  it loads pydantic, and `fab --list` does without

    return (
        Robot(name="anybody", address="localhost", known_hosts=robots[0].known_hosts)
        if robots
        else Robot(name="anybody", address="localhost")
    )


def _models(seen: Iterable[Sighting], robots: Iterable[Robot]) -> dict[str, str]:
    """Ask the robots that are trusted, and where they should be, for their model."""
    there = {one.robot for one in seen if one.here and one.key == "known"}
    models = {}
    for robot in robots:
        if robot.name in there:
            link = Link(robot)
            try:
                models[robot.name] = link.run("sh", "-c", _MODEL, limit=10).strip()
            except FleetError:
                continue  # it is there; why it lets nobody in is what other verbs tell
            finally:
                link.close()
    return models


def _row(one: Sighting, model: str) -> list[tuple[str, str]]:
    where = one.candidate
    computer = model or ", ".join(filter(None, (where.maker, where.system)))
    robot = f"{one.robot} (inventory: {one.expected})" if one.moved else one.robot
    style = {"known": "green", "changed": "bold red", "copied": "bold red"}.get(one.key, "yellow")
    return [
        (", ".join((where.where, *(other.where for other in one.also))), ""),
        (where.name, ""),
        (robot, "bold yellow" if one.moved else "bold"),
        (computer, ""),
        (f"{one.key} {one.fingerprint}", style),
    ]


def _advice(seen: Sequence[Sighting], robots: Sequence[Robot], *, scan: bool) -> Iterator[str]:
    for one in seen:
        if one.moved:
            yield f"{one.robot} is at {one.candidate.where}; the inventory says {one.expected}"
    yield from _copies(seen)
    found = {one.robot for one in seen}
    if missing := [robot.name for robot in robots if robot.name not in found]:
        yield f"not found: {', '.join(missing)}"
    others = [one for one in seen if not one.robot]
    if others:
        yield "for the inventory, under `robots:` (choose your names, then `fab trust`):"
        taken = {robot.name for robot in robots}
        for number, one in enumerate(others, start=1):
            yield f"  {_name(one, number, taken)}: {_entry(one.candidate)}"
    if not seen and not scan:
        yield "nobody answers: `fab find --scan` tries each address of this computer's networks"


def _copies(seen: Sequence[Sighting]) -> Iterator[str]:
    """Say which computers have one host key. `fab` could take one for the other."""
    for key in dict.fromkeys(one.fingerprint for one in seen):
        same = [one for one in seen if one.fingerprint == key]
        if len(same) > 1:
            who = " and ".join(
                f"{one.robot or one.candidate.name or 'a computer'} ({one.candidate.where})" for one in same
            )
            yield (
                f"{who} have the same host key. If the inventory has one computer twice, remove one entry. If a card was "
                "copied, give the copy a key of its own: `sudo rm /etc/ssh/ssh_host_*; sudo ssh-keygen -A; sudo reboot` on "
                "it, then `fab trust --changed`"
            )


def _entry(where: Candidate) -> str:
    """What stands after a robot's name in the inventory."""
    address = where.name or (f'"{where.address}"' if ":" in where.address else where.address)
    return address if where.port == 22 else f"{{address: {address}, port: {where.port}}}"


def _name(one: Sighting, number: int, taken: set[str]) -> str:
    """A name for a new robot, that no other has."""
    name = re.sub(r"[^\w-]", "-", one.candidate.name.removesuffix(".local")) or f"robot{number}"
    while name in taken:
        name += "-new"
    taken.add(name)
    return name


VERBS = (await_, find)
