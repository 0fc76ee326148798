"""How does a command become root's on a robot, and may this login do that without a person at the keyboard?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import NotReady

if TYPE_CHECKING:
    from fleet.robot.facts import Facts


def as_root(facts: Facts, *argv: str) -> tuple[str, ...]:
    """The argv that runs ``argv`` as root: by sudo, which is told not to ask, unless the login is root."""
    return argv if facts.login.sudo == "root" else ("sudo", "-n", *argv)


def check(facts: Facts) -> None:
    """Let a login pass that can do root's work.

    Raises:
        NotReady: sudo would ask for a password, or there is no sudo; with the line that cures it.

    """
    if facts.login.sudo == "password":
        raise NotReady(
            f"sudo asks {facts.login.name} for a password",
            cure=f"run `sudo visudo -f /etc/sudoers.d/010_{facts.login.name}-nopasswd` there and write this line: "
            f"{facts.login.name} ALL=(ALL) NOPASSWD: ALL",
        )
    if facts.login.sudo == "none":
        raise NotReady(
            f"{facts.login.name} is not root, and there is no sudo",
            cure="as root, `apt-get install sudo` there and let this login use it; or set `user: root`",
        )
