"""When, and for how long, is a lost connection retried?"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from fleet.units import human_seconds

if TYPE_CHECKING:
    from fleet.errors import RobotError
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress

RETRY_FOR = 180.0
"""Seconds to retry a lost connection: a Pi reboots within two minutes."""

_PAUSES = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
"""Seconds between attempts to reconnect; the last one repeats."""


class RetryTimer:
    """The time left to retry a lost connection, and the pauses between attempts. ``seconds`` is the time in all."""

    def __init__(self, link: Link, *, seconds: float, progress: Progress) -> None:
        self._link = link
        self._seconds = seconds
        self._progress = progress
        self.restart()

    def restart(self) -> None:
        """Allow the whole time again, from now on."""
        self._until, self._pauses = time.monotonic() + self._seconds, iter(_PAUSES)

    def wait(self, problem: RobotError) -> None:
        """Wait before the next attempt, which uses a new connection. Re-raise ``problem`` when the time is used up."""
        left = self._until - time.monotonic()
        if left <= 0 or self._link.closed.is_set():
            raise problem
        self._progress.note(self._link.robot.name, f"{problem.what}; trying again for {human_seconds(left)}")
        self._link.reconnect()
        self._link.closed.wait(min(left, next(self._pauses, _PAUSES[-1])))
