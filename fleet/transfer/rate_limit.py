"""How much of the air may be used? One limit for all robots of a run, so that teleoperation survives an update."""

from __future__ import annotations

import re
import threading
import time

from fleet.errors import UsageError

_UNITS = {"kbit": 1e3 / 8, "mbit": 1e6 / 8, "gbit": 1e9 / 8, "kb": 1e3, "mb": 1e6}

BURST = 0.1
"""Seconds that may be caught up with after a pause: more would be a burst on the air."""


def bytes_per_second(said: str) -> float | None:
    """``8Mbit`` or ``1MB`` as bytes per second; None for no limit.

    Raises:
        Mistake: it is neither.

    """
    if not said:
        return None
    found = re.fullmatch(
        r"([0-9]+(?:\.[0-9]+)?) *(?:([kmg]bit)(?:/s|ps)?|([km]b)(?:/s)?)", said.strip().lower()
    )
    rate = float(found[1]) * _UNITS[found[2] or found[3]] if found else 0.0
    if rate < 1000:
        raise UsageError(
            f"--limit {said} is no rate", cure="write it as 8Mbit (bits) or 1MB (bytes) per second"
        )
    return rate


class RateLimiter:
    """A rate in bytes per second, shared by whoever takes part of it; None lets everything pass."""

    def __init__(self, rate: float | None) -> None:
        self.rate = rate
        self._lock = threading.Lock()
        self._free = 0.0

    def take(self, count: int) -> None:
        """Wait until so many bytes may be sent."""
        if self.rate is None:
            return
        with self._lock:
            now = time.monotonic()
            at = max(self._free, now - BURST)
            self._free = at + count / self.rate
        time.sleep(max(0.0, at - now))
