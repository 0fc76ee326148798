"""Can a robot run containers of its platform?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import NotReady

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts


def ready(facts: Facts, *, robot: Robot) -> None:
    """Check that a robot can run containers of its platform.

    Raises:
        NotReady: what is missing, and its cure.

    """
    provision = f"`fab provision --hosts {robot.name}`"
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
    if robot.platform not in facts.host.platforms:
        runs = " and ".join(facts.host.platforms) or facts.host.machine
        raise NotReady(
            f"it runs {runs}, and the inventory says {robot.platform}",
            cure=f"set `platform: {facts.host.platforms[0]}` for {robot.name}"
            if facts.host.platforms
            else "",
        )
