"""Run commands as root on a robot, if its login may do that without a password."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import NotReady

if TYPE_CHECKING:
    from fleet.robot.facts import Facts


def as_root(facts: Facts, *argv: str) -> tuple[str, ...]:
    """The argv that runs ``argv`` as root: with sudo, which must not ask for a password, unless the login is root."""
    return argv if facts.login.sudo == "root" else ("sudo", "-n", *argv)


def check(facts: Facts) -> None:
    """Check that the login may run commands as root.

    Raises:
        NotReady: sudo asks for a password, or is not installed.

    """
    if facts.login.sudo == "password":
        raise NotReady(
            f"sudo asks {facts.login.name} for a password",
            cure=f"run `sudo visudo -f /etc/sudoers.d/010_{facts.login.name}-nopasswd` on the robot and write this line: "
            f"{facts.login.name} ALL=(ALL) NOPASSWD: ALL",
        )
    if facts.login.sudo == "none":
        raise NotReady(
            f"{facts.login.name} is not root, and sudo is not installed",
            cure="as root, run `apt-get install sudo` on the robot and let this login use it; or set `user: root`",
        )
