"""Which verbs make a project? ``fab init``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.cli.console import Screen
from fleet.cli.verb import verb
from fleet.errors import UsageError
from fleet.starter import example as examples
from fleet.starter.write import File, planned, write

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from fleet.starter.write import State

_ROBOTS = "Your robots, as NAME=ADDRESS,... (Enter: later):"
_STEPS = "fleet trust, fleet provision, fleet build, fleet ship"
_NEXT_OF_EXAMPLE = (
    "next: write your robots into inventory.yaml, or start virtual ones with `fleet lab.up`",
    f"then: {_STEPS}",
)
_PLATFORM = "Their platform: linux/arm64, linux/arm/v7 or linux/amd64 (Enter: linux/arm64):"


@verb(
    {
        "robots": "names and addresses: pi1=192.168.1.11,pi2=pi2.local",
        "platform": "linux/arm64 (default), linux/arm/v7 or linux/amd64",
        "user": "the login on the robots; default: what OpenSSH's configuration says",
        "distro": "ROS distribution: noetic, humble, jazzy, kilted or rolling; default: noetic or jazzy",
        "example": "write the example instead: a node that publishes the time",
        "yes": "ask nothing",
    }
)
def init(
    robots: str = "",
    platform: str = "",
    user: str = "",
    distro: str = "",
    example: bool = False,
    yes: bool = False,
    dry: bool = False,
    json: bool = False,
) -> None:
    """Write the files of a project into this folder.

    It looks for ROS packages here and writes inventory.yaml, compose.yaml, Dockerfile and .dockerignore for them. A file
    that is there is kept as it is. Without a terminal, or with --yes, the flags alone count.
    """
    screen, folder = Screen(), Path()
    typed = {"robots": robots, "platform": platform, "user": user, "distro": distro}
    notes: Iterable[str]
    if example:
        files, notes = _example(typed), _NEXT_OF_EXAMPLE
    else:
        if not (yes or dry or json or os.path.lexists(folder / "inventory.yaml")):
            typed = _answers(typed, screen)
        files, notes = _own(typed, folder)
    states = planned(files, folder=folder) if dry else write(files, folder=folder)
    if json:
        screen.json([{"file": name, "state": state} for name, state in states.items()])
        return
    screen.lines(_lines(states, dry=dry))
    for note in notes:
        screen.say(note)


def _answers(typed: Mapping[str, str], screen: Screen) -> dict[str, str]:
    """Ask for the robots and the platform, if no flag says them."""
    robots = typed["robots"] or screen.ask(_ROBOTS, default="")
    return {**typed, "robots": robots, "platform": typed["platform"] or screen.ask(_PLATFORM, default="")}


def _example(typed: Mapping[str, str]) -> dict[str, File]:
    if useless := next((name for name, value in typed.items() if value), ""):
        raise UsageError(
            f"--{useless} has no effect with --example",
            cure="edit inventory.yaml after `fleet init --example`",
        )
    return {
        name: File(data=path.read_bytes(), executable=os.access(path, os.X_OK))
        for name, path in examples.files().items()
    }


def _own(typed: Mapping[str, str], folder: Path) -> tuple[dict[str, File], tuple[str, ...]]:
    """Return the files for the packages of a folder, and what to say about them."""
    from fleet.starter import packages, project  # noqa: PLC0415  they load pydantic, and `fab --list` does without

    request = project.Request(
        robots=project.robots(typed["robots"]),
        platform=typed["platform"] or project.Request.platform,
        user=typed["user"],
        distro=typed["distro"],
    )
    project.check(request)
    there = [path.as_posix() for pattern in ("*", "*/*") for path in folder.glob(pattern)]
    draft = project.draft(request, packages=packages.find(folder), folder=folder.resolve().name, there=there)
    files = {name: File(data=text.encode()) for name, text in draft.files.items()}
    return files, (*draft.notes, *_next(typed, kept="inventory.yaml" in there))


def _next(typed: Mapping[str, str], *, kept: bool) -> Iterator[str]:
    if kept:
        if useless := [f"--{name}" for name in ("robots", "platform", "user") if typed[name]]:
            yield f"{', '.join(useless)} had no effect: inventory.yaml was there"
    elif not typed["robots"]:
        yield "next: write your robots into inventory.yaml, or start virtual ones with `fleet lab.up`"
        return
    yield f"next: {_STEPS}"


def _lines(states: Mapping[str, State], *, dry: bool) -> list[str]:
    word = "would write" if dry else "wrote"
    return [
        f"{word} {name}" if state == "written" else f"kept {name}: it was there"
        for name, state in states.items()
    ]


VERBS = (init,)
