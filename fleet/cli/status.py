"""How does a robot's state read in one row?"""

from __future__ import annotations

import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from fleet.errors import FleetError
from fleet.plan.outcome import failure
from fleet.robot.history import Event, history
from fleet.units import human_bytes, human_seconds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from fleet.plan.outcome import Outcome
    from fleet.robot.facts import Container, Facts, StackFacts

EVENT_COLUMNS = ("robot", "stack", "when (UTC)", "what", "release", "by", "outcome")
COLUMNS = ("robot", "reachable", "stack", "release", "containers", "data", "docker", "disk free", "temp")

Cell = tuple[str, str]
"""A text and the style it is shown in."""


def rows(name: str, seen: Facts | FleetError) -> list[Sequence[Cell]]:
    """The rows of one robot, as in `COLUMNS`: one for each stack."""
    nothing = ("", "")
    if isinstance(seen, FleetError):
        return [
            ((name, "bold"), ("no", "bold red"), nothing, nothing, (seen.what, "red"), *[nothing] * 4),
        ]
    host = (
        _docker(seen),
        _disk(seen),
        _temperature(seen.host.temperature),
    )
    stacks = [
        (
            (f"{stack} (systemd)" if there.boot == "systemd" else stack, ""),
            _release(there),
            _containers(there, seen.host.clock),
            _data(there),
        )
        for stack, there in seen.fleet.stacks.items()
    ]
    empty = (nothing, ("none", "dim"), ("none", "dim"), nothing)
    first, *others = stacks or [empty]
    return [
        ((name, "bold"), ("yes", "green"), *first, *host),
        *(((name, "dim"), nothing, *other, *[nothing] * 3) for other in others),
    ]


def table(names: Sequence[str], seen: Mapping[str, Facts | FleetError]) -> list[Sequence[Cell]]:
    """The rows of all robots that were seen, in the order of ``names``."""
    return [row for name in names if name in seen for row in rows(name, seen[name])]


class Arrivals:
    """The rows of robots in the order in which they answer; those that do not answer come last.

    ``seen`` is filled by other threads. Set ``over`` when nobody answers any more.
    """

    def __init__(self, names: Sequence[str], seen: Mapping[str, Facts | FleetError]) -> None:
        self._names = names
        self._seen = seen
        self._arrived: list[str] = []
        self.over = False

    def rows(self) -> list[Sequence[Cell]]:
        """The rows so far; later ones follow at the end."""
        last = (False, True) if self.over else (False,)
        for away in last:
            self._arrived += [
                name
                for name in self._names
                if name in self._seen
                and name not in self._arrived
                and isinstance(self._seen[name], FleetError) == away
            ]
        return table(self._arrived, self._seen)


def total(seen: Mapping[str, Facts | FleetError]) -> str:
    """How many robots there are, and how they are: ``3 robots: 1 well, 1 not well, 1 not reachable``."""
    counted = {
        "well": sum(good(what) for what in seen.values()),
        "not well": sum(not good(what) and not isinstance(what, FleetError) for what in seen.values()),
        "not reachable": sum(isinstance(what, FleetError) for what in seen.values()),
    }
    parts = ", ".join(f"{count} {words}" for words, count in counted.items() if count)
    return f"{len(seen)} {'robot' if len(seen) == 1 else 'robots'}: {parts}"


def good(seen: Facts | FleetError) -> bool:
    """Whether the robot answers and all it was sent runs well."""
    if isinstance(seen, FleetError):
        return False
    return all(_good(there, seen.host.clock) for there in seen.fleet.stacks.values())


def _good(there: StackFacts, now: float) -> bool:
    """Whether a stack runs its current release, or was taken off; a container that ends again and again is not well."""
    if not there.current and not there.containers:
        return True
    return there.running and not there.journal and not any(one.looping(now) for one in there.containers)


def record(seen: Facts | FleetError) -> dict[str, Any]:
    """One robot's state for programs."""
    if isinstance(seen, FleetError):
        return {"reachable": False, "reason": seen.what, "cure": seen.cure}
    facts = asdict(seen)
    for bulky in ("images", "image_store", "claims"):  # for planning; a program would ask Docker
        del facts["fleet"][bulky]
    for name, there in seen.fleet.stacks.items():
        facts["fleet"]["stacks"][name]["came"] = came(there)
    return {"reachable": True, "healthy": good(seen), **facts}


def events(seen: Facts | FleetError) -> tuple[tuple[str, Event], ...]:
    """A robot's history, oldest first, each event with the name of its stack."""
    if isinstance(seen, FleetError):
        return ()
    found = [(stack, event) for stack, there in seen.fleet.stacks.items() for event in history(there.history)]
    return tuple(sorted(found, key=lambda pair: pair[1].when))


def event_row(name: str, stack: str, event: Event) -> Sequence[Cell]:
    """The cells of one event, as in `EVENT_COLUMNS`."""
    when = event.when.replace("T", " ").rstrip("Z")
    style = "green" if event.outcome == "done" else "red"
    return (
        (name, "bold"),
        (stack, ""),
        (when, ""),
        (event.verb, ""),
        (event.release, ""),
        (event.by, ""),
        (event.outcome, style),
    )


def problems(seen: Mapping[str, Facts | FleetError]) -> tuple[Outcome, ...]:
    """The outcomes of the robots that could not be looked at."""
    return tuple(failure(name, what) for name, what in seen.items() if isinstance(what, FleetError))


def _release(there: StackFacts) -> Cell:
    """The current release, and who has changed its containers with `fab dev`, since when (UTC)."""
    if there.dev:
        since = there.dev.since.replace("T", " ").removesuffix("Z")
        return (f"{there.current}, dev by {there.dev.by} since {since} UTC", "yellow")
    way = came(there)
    if way not in ("", "ssh"):
        return (f"{there.current}, by {way}", "")
    return (there.current or "none", "" if there.current else "dim")


def came(there: StackFacts) -> str:
    """How the current release came: ``ssh``, ``stick``, ``registry through SSH`` or ``registry 10.0.0.5:5000``; "" if nobody knows."""
    ships = (event for event in reversed(history(there.history)) if event.verb == "ship")
    by = next((one.by for one in ships if (one.release, one.outcome) == (there.current, "done")), "")
    found = re.search(r" by (stick|registry (?:through SSH|\S+))", by)
    return found[1] if found else "ssh" if by else ""


def _containers(there: StackFacts, now: float) -> Cell:
    missing = [name for name in there.services if name not in {one.service for one in there.containers}]
    texts = [_container(one, there.current, now) for one in there.containers]
    texts += [f"{name} has no container" for name in missing]
    if there.journal:
        texts.append(f"a swap is under way ({' '.join(there.journal.split()[:3])})")
    if not texts:
        return ("none", "red" if there.current else "dim")
    return (", ".join(texts), "green" if _good(there, now) else "red")


def _container(one: Container, current: str, now: float) -> str:
    """``talker healthy 3 min``: its state, for how long, how often it was restarted, and the release if it is another."""
    age = human_seconds(max(0.0, now - one.since)) if one.since else ""
    if one.completed:
        words = [one.service, "completed", f"{age} ago" if age else ""]
    elif one.state in ("exited", "dead"):
        words = [one.service, f"exited with code {one.code}", f"{age} ago" if age else ""]
    else:
        words = [one.service, one.health or one.state, age]
    if one.restarts:
        words.append(f"(restarted {one.restarts} times)" if one.restarts > 1 else "(restarted once)")
    if one.release != current:
        words.append(f"of release {one.release}")
    return " ".join(filter(None, words))


def _data(there: StackFacts) -> Cell:
    """The size of what its containers have written."""
    if there.data is None:
        return ("large", "")
    return (human_bytes(there.data) if there.data else "", "")


def _docker(facts: Facts) -> Cell:
    """Docker's version, and NVIDIA's Linux of a Jetson; in red its state if it does not run, or another engine's name."""
    docker, l4t = facts.docker, facts.hardware.l4t
    if docker.kind not in ("docker", ""):
        return (f"{docker.kind}, not usable", "red")
    if docker.state != "ready":
        return (docker.state, "red")
    return (f"{docker.version} (L4T {l4t})" if l4t else docker.version, "")


def reboots(seen: Mapping[str, Facts | FleetError]) -> Iterator[str]:
    """A line for each robot that waits for a reboot."""
    for name, what in seen.items():
        if not isinstance(what, FleetError) and what.hardware.reboot_for:
            yield f"{name} has to be rebooted to switch on {', '.join(what.hardware.reboot_for)}"


def described(facts: Facts) -> dict[str, Any]:
    """What a person may want to know of a robot before writing the inventory, as far as it is known."""
    host, docker, hardware = facts.host, facts.docker, facts.hardware
    raw = {True: "yes", False: "no (Docker 28 and newer need it)", None: ""}[hardware.raw_table]
    known: dict[str, Any] = {
        "board": hardware.model,
        "system": host.os,
        "machine": host.machine,
        "l4t": hardware.l4t,
        "docker": docker.version or docker.state,
        "runtimes": [name for name in docker.runtimes if not name.startswith("io.containerd.")],
        "cdi": hardware.cdi,
        "raw table": raw,
        "interfaces": hardware.interfaces,
        "wait for a reboot": hardware.reboot_for,
        "groups": facts.login.groups,
        "devices": hardware.devices,
    }
    return {
        key: ", ".join(value) if isinstance(value, list | tuple) else value
        for key, value in known.items()
        if value
    }


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
