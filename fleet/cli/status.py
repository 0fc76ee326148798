"""How is a robot's state shown in one row?"""

from __future__ import annotations

import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from fleet.errors import FleetError
from fleet.plan.outcome import failure
from fleet.robot.history import Event, history
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.plan.outcome import Outcome
    from fleet.robot.facts import Container, Facts

EVENT_COLUMNS = ("robot", "when (UTC)", "what", "release", "by", "outcome")
COLUMNS = ("robot", "reachable", "release", "containers", "docker", "disk free", "temp")

Cell = tuple[str, str]
"""A text and its style."""


def row(name: str, seen: Facts | FleetError) -> Sequence[Cell]:
    """Return one robot's cells, in the order of `COLUMNS`."""
    if isinstance(seen, FleetError):
        return (
            (name, "bold"),
            ("no", "bold red"),
            ("", ""),
            (seen.what, "red"),
            ("", ""),
            ("", ""),
            ("", ""),
        )
    return (
        (name, "bold"),
        ("yes", "green"),
        (seen.fleet.current or "none", "" if seen.fleet.current else "dim"),
        _containers(seen),
        (seen.docker.version, "") if seen.docker.state == "ready" else (seen.docker.state, "red"),
        _disk(seen),
        _temperature(seen.host.temperature),
    )


def good(seen: Facts | FleetError) -> bool:
    """Whether the robot answers and all its containers are healthy."""
    if isinstance(seen, FleetError):
        return False
    return all(c.healthy and c.release == seen.fleet.current for c in seen.fleet.containers) and (
        bool(seen.fleet.containers) or not seen.fleet.current
    )


def record(seen: Facts | FleetError) -> dict[str, Any]:
    """Return one robot's state for ``--json``."""
    if isinstance(seen, FleetError):
        return {"reachable": False, "reason": seen.what, "cure": seen.cure}
    facts = asdict(seen)
    for bulky in ("images", "image_store"):  # for planning; a program would ask Docker
        del facts["fleet"][bulky]
    return {"reachable": True, "healthy": good(seen), **facts}


def events(seen: Facts | FleetError) -> tuple[Event, ...]:
    """Return a robot's history, oldest event first."""
    return () if isinstance(seen, FleetError) else history(seen.fleet.history)


def event_row(name: str, event: Event) -> Sequence[Cell]:
    """Return one event's cells, in the order of `EVENT_COLUMNS`."""
    when = event.when.replace("T", " ").rstrip("Z")
    style = "green" if event.outcome == "done" else "red"
    return (
        (name, "bold"),
        (when, ""),
        (event.verb, ""),
        (event.release, ""),
        (event.by, ""),
        (event.outcome, style),
    )


def problems(seen: Mapping[str, Facts | FleetError]) -> tuple[Outcome, ...]:
    """Return the outcomes of the robots that could not be observed."""
    return tuple(failure(name, what) for name, what in seen.items() if isinstance(what, FleetError))


def _containers(facts: Facts) -> Cell:
    if not facts.fleet.containers:
        return ("none", "red" if facts.fleet.current else "dim")
    text = ", ".join(_container(container, facts.fleet.current) for container in facts.fleet.containers)
    return (text, "green" if good(facts) else "red")


def _container(container: Container, current: str) -> str:
    """Shorten Docker's status to ``talker healthy 3 minutes``; name the release if it is not the current one."""
    health = re.search(r"\((?:health: )?(\w+)\)", container.status)
    since = re.sub(r"^Up |\s*\([^)]*\)|About ", "", container.status)
    state = health[1] if health else container.state
    other = f" of release {container.release}" if container.release != current else ""
    return (
        f"{container.service} {state} {since}{other}".strip()
        if container.state == "running"
        else (f"{container.service} {container.status}{other}")
    )


def _disk(facts: Facts) -> Cell:
    if not facts.disk.size:
        return ("", "")
    share = facts.disk.free / facts.disk.size
    return (f"{human_bytes(facts.disk.free)} ({share:.0%})", "red" if share < 0.1 else "")


def _temperature(celsius: float | None) -> Cell:
    """A Pi slows down from 80 °C."""
    if celsius is None:
        return ("", "")
    return (f"{celsius:.0f} °C", "red" if celsius >= 80 else "yellow" if celsius >= 70 else "")
