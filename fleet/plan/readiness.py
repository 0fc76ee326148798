"""Can a robot run containers of its platform?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.diagnosis.packages import PACKAGES
from fleet.errors import NotReady, Refused
from fleet.platforms import NAMES

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts


_AGAIN = "then run the same command again"

_OTHERS = {
    "podman": (
        "its `docker` command leads to podman, which fleet cannot use",
        "`sudo apt-get remove podman-docker` on the robot (podman itself may stay)",
    ),
    "podman socket": (
        "its `docker` command leads to podman, which fleet cannot use",
        "remove what leads to podman on the robot: its `docker` command, DOCKER_HOST, or the link /run/docker.sock",
    ),
    "rootless": (
        "its Docker is rootless: containers reach neither the robot's network nor its devices",
        "`dockerd-rootless-setuptool.sh uninstall` and `docker context use default` on the robot",
    ),
    "snap": (
        "its Docker is snap's, which cannot read ~/.fleet",
        "`sudo snap remove docker` on the robot, which also removes its containers, images and volumes",
    ),
}


def manageable(facts: Facts, *, then: str) -> None:
    """Check that neither the robot's Docker nor its system is of a kind that fleet cannot use, and cannot change.

    ``then`` is what to do after another engine was removed.

    Raises:
        NotReady: podman, a rootless Docker or snap's Docker; a home without a place for fleet; missing commands.

    """
    kind: str = facts.docker.kind
    if kind == "podman" and "podman-docker" not in facts.packages.installed:
        kind = "podman socket"
    if other := _OTHERS.get(kind):
        raise NotReady(other[0], cure=f"{other[1]}; then {then}")
    login = facts.login
    if login.home_state == "missing":
        cure = f"create it on the robot: `sudo mkhomedir_helper {login.name}`, or change it with `usermod`; {_AGAIN}"
        raise NotReady(f"{login.name} has no home directory: {login.home} is missing", cure=cure)
    if login.home_state == "foreign":
        raise NotReady(
            f"{login.name} cannot write to its home {login.home}, which belongs to another user",
            cure=f"`sudo chown {login.name}: {login.home}` on the robot; {_AGAIN}",
        )
    if missing := facts.host.missing:
        packages = " ".join(dict.fromkeys(PACKAGES.get(name, name) for name in missing))
        raise NotReady(
            f"commands that fleet needs are missing on it, or are busybox's: {', '.join(missing)}",
            cure=f"`sudo apt-get install {packages}` on the robot; {_AGAIN}",
        )


def no_platform(facts: Facts) -> NotReady:
    """The refusal of a robot whose processor no image of fleet runs on."""
    return NotReady(
        f"there are no images for its processor ({facts.host.machine or 'unknown'})",
        cure=f"use a computer that runs {', '.join(NAMES[:-1])} or {NAMES[-1]}",
    )


def ready(facts: Facts, *, robot: Robot) -> None:
    """Check that a robot can run containers of its platform.

    Raises:
        NotReady: what is missing, and its cure.

    """
    provision = f"`fab provision --hosts {robot.name}`"
    manageable(facts, then=provision)
    problems = {
        "absent": ("Docker is not installed", provision),
        "stopped": (
            "Docker is installed and not running",
            f"{provision}, or see `journalctl -u docker` there",
        ),
        "forbidden": (
            f"{facts.login.name} may not use Docker",
            f"{provision} puts the login into the docker group",
        ),
    }
    if problem := problems.get(facts.docker.state):
        raise NotReady(problem[0], cure=problem[1])
    if not facts.docker.compose:
        raise NotReady("Docker's Compose plugin is missing", cure=provision)
    if not facts.host.platforms:
        raise no_platform(facts)
    if robot.platform not in facts.host.platforms:
        raise Refused(
            f"it runs {' and '.join(facts.host.platforms)}, and the inventory says {robot.platform}",
            cure=f"set `platform: {facts.host.platforms[0]}` for {robot.name}",
        )
