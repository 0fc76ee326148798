"""Robots that are real SSH servers on this computer, each with a home of its own in a temporary folder."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.plan.outcome import Outcome
    from tests.support.sshd import Sshd, Sshds


@dataclass(frozen=True, kw_only=True)
class Home:
    """One robot: its server, and the folder in which its commands start."""

    server: Sshd
    path: Path

    @property
    def robot(self) -> Robot:
        return self.server.robot()

    @property
    def history(self) -> list[list[str]]:
        """The fields of its history's lines."""
        file = self.path / ".fleet/history"
        return [line.split("\t") for line in file.read_text().splitlines()] if file.exists() else []

    @property
    def logins(self) -> int:
        """How many connections have logged in so far."""
        return self.server.log.read_text().count("Accepted publickey")


def start(sshds: Sshds, name: str, *, before: str = "", trusted: bool = True) -> Home:
    """Start a robot. ``before`` is a line of shell that runs before every command, as a login script does."""
    path = sshds.folder / f"home of {name}"
    path.mkdir(exist_ok=True)
    said = f"{before}; " if before else ""
    own = f'export HOME="{path}" PATH="{identity(sshds.folder, name)}:$PATH"'
    run = f'ForceCommand cd "{path}" && {own} && {said}exec sh -c "$SSH_ORIGINAL_COMMAND"'
    return Home(server=sshds.start(name, options=(run,), trusted=trusted), path=path)


def identity(folder: Path, name: str) -> Path:
    """A folder for the front of a robot's PATH that gives it a machine-id of its own: all share this computer's."""
    programs = folder / f"identity of {name}"
    programs.mkdir(exist_ok=True)
    cat = programs / "cat"
    cat.write_text(f'#!/bin/sh\n[ "$1" != /etc/machine-id ] || exec echo "{name}"\nexec /bin/cat "$@"\n')
    cat.chmod(0o755)
    own_docker(programs)
    return programs


def own_docker(programs: Path) -> None:
    """Hide the stacks that other tests run in this computer's Docker, if it has one, from a robot with this folder in its PATH."""
    docker = programs / "docker"
    if (real := shutil.which("docker")) and not docker.exists():
        docker.write_text(
            f"""#!/bin/sh
case "$*" in "ps "*'.Label "fleet.release"'*) {real} "$@" | sed 's/|[^|]*|/||/' && exit ;; esac
exec {real} "$@"
"""
        )
        docker.chmod(0o755)


def program(folder: Path, name: str, *, called: str, text: str) -> None:
    """Give a robot a program, in front of this computer's own."""
    path = identity(folder, name) / called
    path.write_text(text)
    path.chmod(0o755)


class Told:
    """A `fleet.rollout.progress.Progress` that remembers what it was told."""

    def __init__(self) -> None:
        self.announced: list[tuple[tuple[str, ...], str]] = []
        self.began_with: list[tuple[str, str, int | None]] = []
        self.bytes = 0
        self.said: list[tuple[str, str]] = []
        self.ended_with: list[Outcome] = []

    def announce(self, robots: Sequence[str], title: str) -> None:
        self.announced.append((tuple(robots), title))

    def step_started(self, robot: str, title: str, size: int | None) -> None:
        self.began_with.append((robot, title, size))

    def bytes_sent(self, robot: str, count: int) -> None:  # noqa: ARG002  a protocol's
        self.bytes += count

    def note(self, robot: str, text: str) -> None:
        self.said.append((robot, text))

    def finished(self, outcome: Outcome) -> None:
        self.ended_with.append(outcome)


def statuses(outcomes: Iterable[Outcome]) -> dict[str, str]:
    """Robot -> status, in order."""
    return {outcome.robot: outcome.status for outcome in outcomes}
