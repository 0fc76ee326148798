"""How fast was the link to each robot when it was last used? A file keeps the rates for forecasts."""

from __future__ import annotations

import contextlib
import json
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


ENOUGH_TO_MEASURE = 500_000
"""Bytes. A smaller transfer fits into buffers on the way, and does not measure the link."""


class LinkRates:
    """The last measured rate of each robot's link in bytes per second, kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def of(self, address: str) -> float | None:
        """The last measured rate to an address; None if it is unknown."""
        return self._read().get(address)

    def note(self, address: str, count: int, seconds: float) -> None:
        """Record the rate of a transfer that is large enough to measure the link. A file that cannot be written is ignored."""
        if count >= ENOUGH_TO_MEASURE and seconds > 0:
            with contextlib.suppress(OSError):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                rates = {**self._read(), address: round(count / seconds)}
                part = self._path.with_suffix(f".{os.getpid()}")
                part.write_text(json.dumps(rates), encoding="utf-8")
                part.replace(self._path)

    def _read(self) -> dict[str, float]:
        try:
            rates = json.loads(self._path.read_text(encoding="utf-8"))
            return {str(name): float(rate) for name, rate in rates.items()}
        except (OSError, ValueError, AttributeError, TypeError, OverflowError):
            return {}


def lowest(*rates: float | None) -> float | None:
    """The lowest known rate; None if all are unknown."""
    return min((rate for rate in rates if rate), default=None)
