"""Do a publisher and a subscriber of ROS 2 match?

A subscriber says what it wants, a publisher what it offers. If it offers less, DDS does not connect them, and neither of
them says a word: https://docs.ros.org/en/jazzy/Concepts/Intermediate/About-Quality-of-Service-Settings.html.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isinf

_DURABILITIES = ("volatile", "transient local", "transient", "persistent")
_LIVELINESS = ("automatic", "manual by node", "manual by topic")


@dataclass(frozen=True, kw_only=True)
class Quality:
    """What a publisher offers, or a subscriber wants. ``deadline`` and ``lease`` are in seconds.

    ``durability`` and ``liveliness`` are DDS's numbers: more is more. ``lease`` belongs to liveliness.
    """

    reliable: bool = False
    durability: int = 0
    deadline: float = inf
    liveliness: int = 0
    lease: float = inf

    def __str__(self) -> str:
        """Return the two that people choose: ``reliable, volatile``."""
        return f"{_reliability(reliable=self.reliable)}, {_name(_DURABILITIES, self.durability)}"


def mismatches(*, offered: Quality, wanted: Quality) -> tuple[str, ...]:
    """Return a clause for each quality in which a publisher offers less than a subscriber wants."""
    found = []
    if wanted.reliable and not offered.reliable:
        found.append("it wants reliable messages, and the publisher is best effort")
    if wanted.durability > offered.durability:
        found.append(
            f"it wants the messages of before ({_name(_DURABILITIES, wanted.durability)}), and the publisher is "
            f"{_name(_DURABILITIES, offered.durability)}"
        )
    if wanted.deadline < offered.deadline:
        found.append(
            f"its deadline is {wanted.deadline:g} s, and that of the publisher is {_seconds(offered.deadline)}"
        )
    if wanted.liveliness > offered.liveliness or wanted.lease < offered.lease:
        found.append(f"its liveliness is {_alive(wanted)}, and that of the publisher is {_alive(offered)}")
    return tuple(found)


def _reliability(*, reliable: bool) -> str:
    return "reliable" if reliable else "best effort"


def _name(names: tuple[str, ...], number: int) -> str:
    return names[number] if 0 <= number < len(names) else str(number)


def _seconds(value: float) -> str:
    return "not limited" if isinf(value) else f"{value:g} s"


def _alive(quality: Quality) -> str:
    return f"{_name(_LIVELINESS, quality.liveliness)} with a lease that is {_seconds(quality.lease)}"
