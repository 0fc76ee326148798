"""Which commands write, start, stop and remove a stack on a robot?

What changes containers is a script that goes on without the desktop (`onboard/swap.sh` in `onboard/detach.sh`): a lost
connection, a Ctrl-C or a closed laptop do not stop it half-way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fleet import onboard
from fleet.plan.step import Bytes, Record, Step
from fleet.robot.history import Event
from fleet.robot.paths import folder

if TYPE_CHECKING:
    from fleet.robot.release import Release

Verb = Literal["ship", "rollback", "start", "restart", "stop", "dev"]
Conflict = Literal["robot", "desktop"]

UNKNOWN = "?"
"""In place of the release that was current when a swap was planned: nobody compares."""

TURN = 240
"""Seconds to wait for another person's command on the same robot to end; `onboard/swap.sh` has it too."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """Who asks for a change, and for how long it may take.

    ``by`` is ``tim@desktop``; ``run`` is a word that no other run of a command has: with it a desktop that lost its
    connection comes back to what it began. ``wait`` are the seconds that containers may take to become healthy,
    ``settle`` those that one without a health check must run. ``conflict`` says whose version of a file wins that both
    robot and desktop have changed.
    """

    by: str
    run: str
    wait: int = 180
    settle: int = 10
    conflict: Conflict = "robot"


def compose(stack: str, release: str, *arguments: str) -> tuple[str, ...]:
    """The argv of ``docker compose`` in the folder of a release."""
    # The login's own environment must not choose other files or services.
    unset = ("-u", "COMPOSE_FILE", "-u", "COMPOSE_PROFILES", "-u", "COMPOSE_PROJECT_NAME")
    return ("env", "-C", folder(stack, release), *unset, "docker", "compose", *arguments)


def until_closed(argv: tuple[str, ...]) -> tuple[str, ...]:
    """The argv of a command that ends with the connection; its standard input must stay open until then."""
    return ("sh", "-c", onboard.text("until_closed.sh"), "until_closed", *argv)


def write(release: Release, *, home: str) -> Step:
    """Write the folder of a release, whole or not at all."""
    files = release.files(home)
    return Step(
        title=f"write release {release.id} to ~/{folder(release.stack, release.id)}",
        argv=_script("unpack_release.sh", folder(release.stack, release.id)),
        feed=Bytes(label=f"{len(files)} files", data=release.archive(home)),
        harmless=True,
        resumes=True,
    )


def adopt(stack: str) -> Step:
    """Take over the releases of the first version of fleet."""
    return Step(
        title="take over the releases of an earlier version of fleet",
        argv=_script("adopt.sh", stack),
        limit=TURN + 60.0,
        harmless=True,
        resumes=True,
    )


def swap(verb: Verb, stack: str, release: str, *, seen: str, request: Request) -> Step:
    """Bring a stack's containers to a release and watch them; if they do not run, go back to the one before.

    ``seen`` is the release that was current when this was planned, "" if there was none.
    """
    token = f"{request.run}.{stack}"
    numbers = (str(request.wait), str(request.settle))
    return Step(
        title=f"{_WORDS[verb]} release {release}" + (f" of {stack}" if stack else ""),
        argv=(
            *_script("detach.sh", token, onboard.text("swap.sh"), "swap"),
            *(verb, stack, release, seen or "-", request.by, *numbers, request.conflict),
        ),
        # Its turn; the release; and the one before, if that has to be started again. Compose may take 120 s more each.
        limit=TURN + 2.0 * (request.wait + request.settle + 120) + 60,
        resumes=True,
        detached=True,
    )


_WORDS: dict[Verb, str] = {
    "ship": "start",
    "rollback": "start",
    "start": "start",
    "restart": "restart",
    "stop": "stop",
    "dev": "bring back",
}


def remove(stack: str, *, by: str) -> Step:
    """Take a stack off the robot, but for its data and its volumes."""
    return Step(
        title=f"remove stack {stack}",
        argv=_script("remove_stack.sh", stack, by),
        limit=TURN + 600.0,  # Docker waits for each container's `stop_grace_period`
        resumes=True,
    )


def note(record: Record, *, when: str, outcome: str) -> Step:
    """Append one line to the history of the robot as a whole; ``when`` is in ISO 8601."""
    line = Event(when=when, verb=record.verb, release=record.release, by=record.by, outcome=outcome)
    return Step(
        title="note it in the history", argv=_script("note_history.sh", str(line)), limit=20.0, resumes=True
    )


def _script(name: str, *arguments: str) -> tuple[str, ...]:
    return ("sh", "-c", onboard.text(name), name.removesuffix(".sh"), *arguments)
