"""The words of the talker, free of ROS so that they can be tried anywhere."""

from __future__ import annotations

from datetime import datetime, timezone


def iso_time(seconds: float) -> str:
    """Return a moment, in seconds since 1970 UTC, as people read it: ``2026-11-23T22:36:01.250Z``."""
    moment = datetime.fromtimestamp(seconds, tz=timezone.utc)  # noqa: UP017 - a Noetic image has Python 3.8
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def messages_per_second(value: object) -> float:
    """Return a rate as a parameter or launch argument gives it; ValueError says why it cannot be one."""
    try:
        rate = float(value)  # type: ignore[arg-type]  # refusing what is no number is this function's work
    except (TypeError, ValueError):
        raise ValueError(f"rate is {value!r}, which is not a number of messages a second") from None
    if not 0 < rate <= 1000:
        raise ValueError(f"rate is {value!r}, and must be above 0 and at most 1000 messages a second")
    return rate
