"""What happened to a robot, and who did it?"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Event:
    """One line of a robot's history, its fields separated by tabs."""

    when: str
    verb: str
    release: str
    by: str
    outcome: str

    def __str__(self) -> str:
        fields = (self.when, self.verb, self.release, self.by, self.outcome)
        return "\t".join(" ".join(value.split()) for value in fields)


def history(lines: tuple[str, ...]) -> tuple[Event, ...]:
    """The events of a robot's history, oldest first. A line with another number of fields (cut by a full disk) is skipped."""
    fields = (line.split("\t") for line in lines)
    return tuple(
        Event(when=f[0], verb=f[1], release=f[2], by=f[3], outcome=f[4]) for f in fields if len(f) == 5
    )
