"""Who is told how it goes?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from fleet.plan.outcome import Outcome


class Progress(Protocol):
    """Whoever is told how it goes; called from many threads."""

    def step_started(self, robot: str, title: str, size: int | None) -> None:
        """A robot starts something; ``size`` is in bytes where bytes will flow."""

    def bytes_sent(self, robot: str, count: int) -> None:
        """So many more bytes have left."""

    def note(self, robot: str, text: str) -> None:
        """Something about a robot that a person may want to know, and that is no step."""

    def finished(self, outcome: Outcome) -> None:
        """A robot is through."""


class NoProgress:
    """Progress that nobody is shown: what a verb prints tells enough."""

    def step_started(self, robot: str, title: str, size: int | None) -> None:
        """See `Progress`."""

    def bytes_sent(self, robot: str, count: int) -> None:
        """See `Progress`."""

    def note(self, robot: str, text: str) -> None:
        """See `Progress`."""

    def finished(self, outcome: Outcome) -> None:
        """See `Progress`."""
