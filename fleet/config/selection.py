"""Which robots do these names mean?

Names, wildcards and near misses, over plain text: the inventory's groups and ``--hosts`` follow the same rules.
"""

from __future__ import annotations

from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from fleet.errors import SelectionError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


def is_wildcard(name: str) -> bool:
    """Whether ``name`` is a pattern (``pi*``, ``pi?``, ``pi[1-3]``) rather than one name."""
    return any(letter in name for letter in "*?[")


def matching(pattern: str, names: Iterable[str]) -> tuple[str, ...]:
    """The ``names`` that match ``pattern``, which is a name or a wildcard; in their order."""
    if is_wildcard(pattern):
        return tuple(name for name in names if fnmatchcase(name, pattern))
    return tuple(name for name in names if name == pattern)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``did you mean 'x'?`` for the nearest of ``known``, "" if none is near. Case is ignored."""
    lowered = {other.lower(): other for other in known}
    nearest = get_close_matches(name.lower(), lowered, n=1, cutoff=0.6)
    return f"did you mean '{lowered[nearest[0]]}'?" if nearest else ""


def choose(hosts: str, *, robots: Iterable[str], groups: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """The names of ``robots`` that ``hosts`` means: a comma list of robots, groups and wildcards over robots.

    In the order of ``robots``, each once. Raises `SelectionError` that names every item which means nobody.
    """
    robots = tuple(robots)
    items = tuple(dict.fromkeys(item.strip() for item in hosts.split(",") if item.strip()))
    if not items:
        raise SelectionError("--hosts is empty", cure="name robots or groups, or say 'all'")
    chosen = {item: groups[item] if item in groups else matching(item, robots) for item in items}
    lost = tuple(item for item in items if not chosen[item])
    if lost:
        raise SelectionError(
            "; ".join(_nobody(item, groups=groups) for item in lost),
            cure=_cure(lost, robots=robots, groups=groups),
        )
    wanted = {name for names in chosen.values() for name in names}
    return tuple(name for name in robots if name in wanted)


def _nobody(item: str, *, groups: Mapping[str, tuple[str, ...]]) -> str:
    if item in groups:
        return f"--hosts {item}: the group has no robots"
    if is_wildcard(item):
        return f"--hosts {item}: matches no robot"
    return f"--hosts {item}: no such robot or group"


def _cure(lost: tuple[str, ...], *, robots: tuple[str, ...], groups: Mapping[str, tuple[str, ...]]) -> str:
    known = (*robots, *groups)
    near = [did_you_mean(item, known) for item in lost if item not in groups]
    meant = " ".join(dict.fromkeys(hint for hint in near if hint))
    return meant or f"there are: {_listed(known)}"


def _listed(names: tuple[str, ...], *, most: int = 12) -> str:
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")
