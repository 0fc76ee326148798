"""Which changed file goes where, and what has to be done on a robot that does not have it yet?

Digests are compared, not events: a robot that was away, and one that was there, are asked the same question.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from fleet.config.watch import Hook, Rule

    Tree = Mapping[str, "Entry"]
    Place = tuple[str, str]
    Has = Mapping[Place, str]

GONE = "-"
"""In place of the digest of a file that is not there."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A file of the desktop: the SHA-256 of its bytes, its mode and its target, if it is a symbolic link; ``size`` in bytes."""

    digest: str
    size: int = 0
    mode: int = 0o644
    link: str | None = None


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What containers of a service should have at one place, and what follows if they have something else.

    ``source`` is the file of the desktop, "" if there is none. ``syncs`` is false for a file that only causes a restart.
    """

    source: str
    digest: str
    syncs: bool
    restart: bool = False
    hooks: tuple[Hook, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Change:
    """One line of the plan for a robot: ``verb`` is put, gone or mark (a file that is not sent)."""

    verb: str
    service: str
    digest: str
    place: str
    source: str = ""

    def __str__(self) -> str:
        return f"{self.verb} {self.service} {self.digest} {self.place}"


@dataclass(frozen=True, kw_only=True)
class Work:
    """What one robot lacks: the files, the services to restart, and the commands to run in containers."""

    changes: tuple[Change, ...] = ()
    restart: tuple[str, ...] = ()
    hooks: tuple[tuple[str, Hook], ...] = ()


def changed(before: Tree, now: Tree) -> frozenset[str]:
    """The files that are new, gone or different."""
    return frozenset(path for path in before.keys() | now.keys() if before.get(path) != now.get(path))


def initial(rules: Sequence[Rule], tree: Tree) -> frozenset[str]:
    """The files that are synced at the start (``initial_sync``)."""
    first = [rule for rule in rules if rule.initial]
    return frozenset(path for path in tree if any(rule.takes(path) for rule in first))


def idle(rules: Iterable[Rule], tree: Tree) -> tuple[Rule, ...]:
    """The rules that no file belongs to: a ``.dockerignore`` that leaves all out is easily forgotten."""
    return tuple(rule for rule in rules if not any(rule.takes(path) for path in tree))


def rebuilds(rules: Iterable[Rule], paths: Iterable[str]) -> str:
    """The first of some changed files that needs a new image, or ""."""
    wanted = [rule for rule in rules if rule.action == "rebuild"]
    return next((path for path in sorted(paths) if any(rule.takes(path) for rule in wanted)), "")


def wanted(rules: Sequence[Rule], paths: Iterable[str], tree: Tree) -> dict[Place, Wanted]:
    """What containers should have of some files. If several rules name one place, all that they ask for is done."""
    found: dict[Place, Wanted] = {}
    for path in paths:
        entry = tree.get(path)
        for rule in rules:
            if rule.action == "rebuild" or not rule.takes(path):
                continue
            place = (rule.service, rule.place(path) if rule.syncs else f"restart:{path}")
            earlier = found.get(place)
            hooks = (*(earlier.hooks if earlier else ()), *((rule.hook,) if rule.hook else ()))
            found[place] = Wanted(
                source=path if entry else "",
                digest=entry.digest if entry else GONE,
                syncs=rule.syncs,
                restart=rule.action.endswith("restart") or bool(earlier and earlier.restart),
                hooks=tuple(dict.fromkeys(hooks)),
            )
    return found


def work(should: Mapping[Place, Wanted], everything: Mapping[Place, Wanted], has: Has) -> Work:
    """What a robot lacks.

    ``should`` is what has changed on the desktop since `fab dev` began, ``everything`` all that the rules are about, and
    ``has`` what was synced to the robot, in this `fab dev` or in an earlier one.
    """
    whole = {place: everything[place] for place in has if place in everything} | dict(should)
    due = {place: one for place, one in whole.items() if has.get(place) != one.digest}
    left = [place for place in has if place not in whole and has[place] != GONE and place[1].startswith("/")]
    changes = [_change(place, one) for place, one in due.items()]
    changes += [Change(verb="gone", service=service, digest=GONE, place=name) for service, name in left]
    return Work(
        changes=tuple(sorted(changes, key=lambda one: (one.service, one.place))),
        restart=tuple(sorted({service for (service, _), one in due.items() if one.restart})),
        hooks=tuple(
            dict.fromkeys((service, hook) for (service, _), one in due.items() for hook in one.hooks)
        ),
    )


def _change(place: Place, one: Wanted) -> Change:
    service, name = place
    verb = "mark" if not one.syncs else "put" if one.source else "gone"
    return Change(verb=verb, service=service, digest=one.digest, place=name, source=one.source)


@dataclass(frozen=True, kw_only=True)
class State:
    """How one container is, in Docker's words."""

    service: str
    state: str
    code: int = 0
    restarts: int = 0
    health: str = "none"


def states(text: str) -> tuple[State, ...]:
    """Read what ``onboard/dev_hold.sh`` prints: ``SERVICE,STATE,CODE,RESTARTS,HEALTH``, separated by spaces."""
    found = []
    for word in text.split():
        match word.split(","):
            case [service, state, code, restarts, health] if restarts.isdecimal():
                number = int(code) if code.lstrip("-").isdecimal() else 0
                found.append(
                    State(service=service, state=state, code=number, restarts=int(restarts), health=health)
                )
            case _:
                pass
    return tuple(found)


def trouble(now: Iterable[State], before: Iterable[State] = ()) -> str:
    """What is wrong with containers, or "". One that was restarted since ``before`` has ended in between."""
    counted = {one.service: one.restarts for one in before}
    return "; ".join(filter(None, (_trouble(one, counted.get(one.service, 0)) for one in now)))


def _trouble(one: State, restarts: int) -> str:
    if one.state == "restarting" or one.restarts > restarts:
        return f"{one.service} ends again and again" + (f" (exit code {one.code})" if one.code else "")
    if one.state in ("exited", "dead") and one.code:
        return f"{one.service} has ended with code {one.code}"
    return f"{one.service} is unhealthy" if one.health == "unhealthy" else ""


def summary(now: Iterable[State]) -> str:
    """How containers are, in a few words: ``talker healthy``."""
    return ", ".join(f"{one.service} {one.state if one.health == 'none' else one.health}" for one in now)
