"""Which commands write, start, stop and note a release on a robot?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet import onboard
from fleet.plan.step import Bytes, Record, Step
from fleet.robot.history import Event
from fleet.robot.paths import folder
from fleet.ros import environment as ros

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.release import Release

_SHADOWING = ("COMPOSE_FILE", "COMPOSE_PROJECT_NAME", "FLEET_ROBOT", *ros.VARIABLES)
"""Variables to unset: Compose prefers the robot's own login environment to the release's ``.env``."""

_TURN = 240
"""Seconds to wait for another person's start on the same robot to end."""


def compose(robot: Robot, release: str, *arguments: str) -> tuple[str, ...]:
    """The argv of ``docker compose`` in the directory of a release."""
    unset = (part for name in (*_SHADOWING, *sorted(robot.environment)) for part in ("-u", name))
    return ("env", "-C", folder(release), *unset, "docker", "compose", *arguments)


def until_closed(argv: tuple[str, ...]) -> tuple[str, ...]:
    """The argv of a command that ends with the connection; its standard input must stay open until then."""
    return ("sh", "-c", onboard.text("until_closed.sh"), "until_closed", *argv)


def write(release: Release) -> Step:
    """Write the directory of a release, whole or not at all."""
    return Step(
        title=f"write release {release.id} to ~/{folder(release.id)}",
        argv=("sh", "-c", onboard.text("unpack_release.sh"), "unpack_release", folder(release.id)),
        feed=Bytes(label=f"{len(release.files)} files", data=release.archive()),
        harmless=True,
        resumes=True,
    )


def start(robot: Robot, release: str, *, wait: int) -> Step:
    """Start a release's containers, wait up to ``wait`` seconds until they are healthy, and make it the current release."""
    flags = (
        "--detach",
        "--wait",
        "--wait-timeout",
        str(wait),
        "--no-build",
        "--pull",
        "never",
        "--remove-orphans",
    )
    scripts = (onboard.text("start_release.sh"), "start_release", str(_TURN), onboard.text("until_closed.sh"))
    return Step(
        title=f"start release {release}",
        argv=("sh", "-c", *scripts, release, *compose(robot, release, "up", *flags)),
        limit=wait + _TURN + 60.0,
        until_closed=True,
        resumes=True,
    )


def stop(robot: Robot, release: str) -> Step:
    """Stop a release's containers; they stay stopped over a reboot."""
    return Step(title=f"stop release {release}", argv=compose(robot, release, "stop"), limit=90.0)


def last_words(robot: Robot, release: str) -> Step:
    """Show the last log lines of a release's containers."""
    return Step(
        title="show the last log lines",
        argv=compose(robot, release, "logs", "--no-color", "--no-log-prefix", "--tail", "8"),
        limit=20.0,
    )


def note(record: Record, *, when: str, outcome: str) -> Step:
    """Append one line to the robot's history; ``when`` is in ISO 8601."""
    line = Event(when=when, verb=record.verb, release=record.release, by=record.by, outcome=outcome)
    return Step(
        title="note it in the history",
        argv=("sh", "-c", onboard.text("note_history.sh"), "note_history", str(line)),
        limit=20.0,
        resumes=True,
    )
