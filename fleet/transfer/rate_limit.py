"""One limit of bytes per second for all robots of a run, so that teleoperation over the same Wi-Fi survives an update."""

from __future__ import annotations

import re
import threading
import time

from fleet.errors import UsageError

_UNITS = {"kbit": 1e3 / 8, "mbit": 1e6 / 8, "gbit": 1e9 / 8, "kb": 1e3, "mb": 1e6}

BURST = 0.1
"""Seconds of unused rate that may be used after a pause; more would be a burst on the Wi-Fi."""


def bytes_per_second(text: str) -> float | None:
    """``8Mbit`` or ``1MB`` as bytes per second; None (no limit) for an empty text.

    Raises:
        UsageError: the text is not a rate, or below 1 kB per second.

    """
    if not text:
        return None
    match = re.fullmatch(
        r"([0-9]+(?:\.[0-9]+)?) *(?:([kmg]bit)(?:/s|ps)?|([km]b)(?:/s)?)", text.strip().lower()
    )
    rate = float(match[1]) * _UNITS[match[2] or match[3]] if match else 0.0
    if rate < 1000:
        raise UsageError(
            f"--limit {text} is not a rate", cure="write it as 8Mbit (bits) or 1MB (bytes) per second"
        )
    return rate


class RateLimiter:
    """A rate in bytes per second that all transfers share; None means no limit."""

    def __init__(self, rate: float | None) -> None:
        self.rate = rate
        self._lock = threading.Lock()
        self._free = 0.0

    def acquire(self, count: int) -> None:
        """Wait until ``count`` bytes may be sent."""
        if self.rate is None:
            return
        with self._lock:
            now = time.monotonic()
            at = max(self._free, now - BURST)
            self._free = at + count / self.rate
        time.sleep(max(0.0, at - now))
