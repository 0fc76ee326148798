"""How fast was the link to each robot?"""

from __future__ import annotations

import contextlib
import json
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


ENOUGH_TO_MEASURE = 500_000
"""Bytes from which on a transfer tells something of the link."""


class LinkRates:
    """How fast each robot's link was when bytes flowed last, in bytes per second, kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def of(self, address: str) -> float | None:
        """The last known rate to an address."""
        return self._read().get(address)

    def note(self, address: str, count: int, seconds: float) -> None:
        """Remember a transfer that tells something."""
        if count >= ENOUGH_TO_MEASURE and seconds > 0:
            with contextlib.suppress(OSError):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                rates = {**self._read(), address: round(count / seconds)}
                part = self._path.with_suffix(f".{os.getpid()}")
                part.write_text(json.dumps(rates), encoding="utf-8")
                part.replace(self._path)

    def _read(self) -> dict[str, float]:
        try:
            said = json.loads(self._path.read_text(encoding="utf-8"))
            return {str(name): float(rate) for name, rate in said.items()}
        except (OSError, ValueError, AttributeError, TypeError, OverflowError):
            return {}


def lowest(*rates: float | None) -> float | None:
    """The lowest of the rates that are known; None if none is."""
    return min((rate for rate in rates if rate), default=None)
