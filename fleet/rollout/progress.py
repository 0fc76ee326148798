"""Who is told how the work goes?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.plan.outcome import Outcome


class Progress(Protocol):
    """The receiver of progress reports. It is called from many threads."""

    def announce(self, robots: Sequence[str], title: str) -> None:
        """Report that all these robots will start the same step; each of them still reports `step_started`."""

    def step_started(self, robot: str, title: str, size: int | None) -> None:
        """Report that a robot starts a step. ``size`` is in bytes, if the step sends any."""

    def bytes_sent(self, robot: str, count: int) -> None:
        """Report that ``count`` more bytes were sent to a robot."""

    def note(self, robot: str, text: str) -> None:
        """Report something about a robot that is not a step."""

    def finished(self, outcome: Outcome) -> None:
        """Report that the work on a robot is over."""


class NoProgress:
    """Progress reports that nobody reads: the verb prints enough."""

    def announce(self, robots: Sequence[str], title: str) -> None:
        """See `Progress`."""

    def step_started(self, robot: str, title: str, size: int | None) -> None:
        """See `Progress`."""

    def bytes_sent(self, robot: str, count: int) -> None:
        """See `Progress`."""

    def note(self, robot: str, text: str) -> None:
        """See `Progress`."""

    def finished(self, outcome: Outcome) -> None:
        """See `Progress`."""
