"""How many messages of a topic arrive in a second, and how old are they?

Pure: times go in, a report comes out about once a second.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence

WINDOW = 10.0
"""Seconds that a report is about: enough for a topic with a message in some seconds."""

MOST = 20_000
"""Messages that a report is about, at most."""

EVERY = 1.0
"""Seconds from one report to the next."""

OF_THE_CLOCK = 10 * 365 * 86_400.0
"""Seconds. A stamp that is older or newer than this is not a time of the robot's clock, but simulated, or never set."""


@dataclass(frozen=True, kw_only=True)
class Report:
    """What was measured lately: messages and bytes in a second, the time between two messages, and their delays, in seconds.

    The delays are None if they were not measured.
    """

    rate: float
    shortest: float
    longest: float
    bytes: float
    delay: float | None = None
    delay_least: float | None = None
    delay_most: float | None = None

    def __str__(self) -> str:
        """Return one line: ``10.0 messages/s, 98 to 103 ms apart, 1.2 kB/s; delay 12 ms (8 to 30 ms)``."""
        apart = f"{_milliseconds(self.shortest)} to {_milliseconds(self.longest)} ms apart"
        text = f"{self.rate:.3g} messages/s, {apart}, {human_bytes(round(self.bytes))}/s"
        if self.delay is None or self.delay_least is None or self.delay_most is None:
            return text
        least, most = _milliseconds(self.delay_least), _milliseconds(self.delay_most)
        return f"{text}; delay {_milliseconds(self.delay)} ms ({least} to {most} ms)"


def _milliseconds(seconds: float) -> str:
    return f"{seconds * 1000:.1f}" if abs(seconds) < 0.01 else f"{seconds * 1000:.0f}"


class Meter:
    """The messages of one topic in the last `WINDOW` seconds."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int, float | None]] = deque(maxlen=MOST)
        self._reported: float | None = None

    def add(self, *, at: float, size: int, delay: float | None = None) -> Report | None:
        """Add a message; returns a report if the last one is a second ago. Times are in seconds, ``size`` in bytes.

        ``at`` is by a clock that nobody sets (`time.monotonic`); a time that is before the last one counts as that one.
        """
        at = max(at, self._seen[-1][0]) if self._seen else at
        self._seen.append((at, size, delay))
        while at - self._seen[0][0] > WINDOW and len(self._seen) > 2:
            self._seen.popleft()
        if self._reported is None:
            self._reported = at
        if at - self._reported < EVERY:
            return None
        self._reported = at
        return self._report()

    def _report(self) -> Report:
        times = [at for at, _, _ in self._seen]
        gaps = [later - earlier for earlier, later in pairwise(times)]
        span = max(times[-1] - times[0], 1e-9)
        delays = [delay for _, _, delay in self._seen if delay is not None]
        return Report(
            rate=len(gaps) / span,
            shortest=min(gaps),
            longest=max(gaps),
            # The first message is the begin of the time, and its bytes came before.
            bytes=sum(size for _, size, _ in list(self._seen)[1:]) / span,
            delay=sum(delays) / len(delays) if delays else None,
            delay_least=min(delays, default=None),
            delay_most=max(delays, default=None),
        )


@dataclass(frozen=True, kw_only=True)
class Clocks:
    """How far a robot's clock is ahead of this computer's, in seconds, and how wrong that may be in either direction."""

    ahead: float
    error: float

    def __str__(self) -> str:
        """Return one clause: ``its clock is 12 ms behind this computer's (± 3 ms)``."""
        where = "ahead of" if self.ahead >= 0 else "behind"
        return f"its clock is {_milliseconds(abs(self.ahead))} ms {where} this computer's (± {_milliseconds(self.error)} ms)"


def clocks(asked: Sequence[tuple[float, float, float]]) -> Clocks:
    """Return the difference of two clocks from questions: when one was asked, what the robot said, when the answer came.

    The answer was true at some time between the two, so the shortest question says most.
    """
    sent, said, came = min(asked, key=lambda times: times[2] - times[0])
    return Clocks(ahead=said - (sent + came) / 2, error=(came - sent) / 2)
