"""Steps that install packages with apt, although other programs use apt too and the power may fail.

A Pi updates itself in the minutes after its first boot, so the steps wait for apt's locks. Every time limit is applied on
the robot and inside sudo, because an ordinary login cannot stop root's processes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.plan.step import Step
from fleet.provision.sudo import as_root

if TYPE_CHECKING:
    from fleet.robot.facts import Facts

INSTALL = ("apt-get", "install", "--yes", "--no-install-recommends")
REMOVE = ("apt-get", "remove", "--yes")


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Time limits in seconds.

    ``lock_timeout``: how long to wait until other programs release apt's locks; on a Pi the updates of a first boot take
    minutes. ``limit``: how long one command may run; Docker's script has no limit of its own, and SD cards are slow.
    ``pause``: time between two attempts while apt is locked. ``silence``: for how long no byte may arrive while something is
    downloaded; apt gives up a list of a silent server after four times ``answer``, and goes on without it, so this is for
    several. ``answer``: how long a package server may take to send the next bytes.
    """

    lock_timeout: int = 600
    limit: int = 1200
    pause: int = 5
    silence: int = 180
    answer: int = 10


def run(title: str, argv: tuple[str, ...], *, facts: Facts, bounds: Bounds, cure: str = "") -> Step:
    """The step that runs ``argv``, a command that uses apt, as root; it is run again while apt is locked."""
    environment = ("env", "LC_ALL=C", "DEBIAN_FRONTEND=noninteractive")
    seconds = (bounds.lock_timeout, bounds.limit, bounds.pause, bounds.silence, bounds.answer)
    return Step(
        title=title,
        argv=as_root(
            facts, *environment, "sh", "-c", onboard.text("apt_run.sh"), "apt_run", *map(str, seconds), *argv
        ),
        limit=bounds.lock_timeout + bounds.limit + 30.0,
        cure=cure,
    )


def reachable(*, bounds: Bounds) -> Step:
    """The step that checks whether any of the robot's package servers answers, and fails within seconds if not."""
    return Step(
        title="check that the robot reaches its package archive",
        argv=("sh", "-c", onboard.text("apt_reach.sh"), "apt_reach", str(bounds.answer)),
        limit=bounds.answer + 75.0,
    )


def compose_plugin(*, facts: Facts, bounds: Bounds) -> Step:
    """The step that installs Docker's Compose plugin for a Docker that lacks it."""
    return run(
        "install Docker's Compose plugin",
        ("sh", "-c", onboard.text("apt_compose.sh")),
        facts=facts,
        bounds=bounds,
        cure="remove this Docker (`sudo apt-get remove docker.io`; images stay), then run the same command again",
    )


def repair(*, facts: Facts, bounds: Bounds) -> Step:
    """The step that completes an installation that a power cut interrupted."""
    argv = ("dpkg", "--configure", "-a")
    return run("complete an interrupted installation of packages", argv, facts=facts, bounds=bounds)


def zstd(*, facts: Facts, bounds: Bounds) -> tuple[Step, ...]:
    """The step that installs zstd, which applies patches of layers. No step without root rights: Docker works without zstd."""
    if "zstd" in facts.packages.installed or facts.login.sudo not in ("root", "free"):
        return ()
    return (run("install zstd", (*INSTALL, "zstd"), facts=facts, bounds=bounds),)
