"""What is a message of a topic that was heard, and how do people and programs get to see it?"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

from fleet.ros import rosmsg

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from fleet.ros.rosmsg import Value

_SECONDS, _NANOSECONDS = ("sec", "secs"), ("nanosec", "nsecs")


@dataclass(frozen=True, kw_only=True)
class Message:
    """A message. ``at`` is when it arrived, in seconds since 1970, by the clock of the computer that heard it.

    ``monotonic`` is the same by a clock of that computer that nobody sets: only the seconds between two messages count.
    ``size`` is in bytes. ``read`` returns its values by field, and raises `NotAsPlanned` if its type cannot be read: who only
    counts messages needs no type.
    """

    at: float
    monotonic: float
    size: int
    read: Callable[[], Mapping[str, Value]]

    def text(self) -> str:
        """Return the values as ``rostopic echo`` shows them."""
        return rosmsg.text(self.read())


def plain(value: Value) -> Any:  # noqa: ANN401  whatever JSON has
    """Return a value as JSON has it: bytes become base64, and numbers that JSON does not have become null."""
    if isinstance(value, rosmsg.Time):
        return value._asdict()
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, list):
        return [plain(one) for one in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    return None if isinstance(value, float) and not isfinite(value) else value


def stamp(values: Mapping[str, Value]) -> float | None:
    """Return the time in a message's header in seconds, or else the time that the message itself is; None without any."""
    header = values.get("header", values)
    if not isinstance(header, dict):
        return None
    time = header.get("stamp", values.get("data", values))
    fields = time._asdict() if isinstance(time, rosmsg.Time) else time
    if not isinstance(fields, dict):
        return None
    whole = next((fields[name] for name in _SECONDS if name in fields), None)
    part = next((fields[name] for name in _NANOSECONDS if name in fields), None)
    if not isinstance(whole, int) or not isinstance(part, int):
        return None
    return whole + part / 1e9
