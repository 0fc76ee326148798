from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.errors import CommandFailed, LinkLost, NotAsPlanned
from fleet.rollout.link import Link
from tests.support.homes import Home, start

if TYPE_CHECKING:
    from tests.support.sshd import Sshds


@pytest.fixture
def home(sshds: Sshds) -> Home:
    return start(sshds, "pi1")


def test_a_link_connects_once_and_again_when_asked(home: Home) -> None:
    """All commands to a robot share a connection; group membership needs a new one."""
    link = Link(home.robot)
    assert home.logins == 0
    assert (link.run("echo", "one"), link.run("echo", "two")) == ("one\n", "two\n")
    assert home.logins == 1
    link.reconnect()
    assert link.run("echo", "three") == "three\n"
    assert home.logins == 2
    link.close()
    with pytest.raises(LinkLost, match="interrupted by Ctrl-C"):
        link.run("echo", "four")


def test_a_command_that_fails_is_explained(home: Home) -> None:
    """What it means where that is known, its own last words where not, its name where it said nothing."""
    link = Link(home.robot)
    for script, what in (
        ("echo 'write x: no space left on device' >&2; exit 3", "the robot's disk is full"),
        ("echo 'some new trouble' >&2; exit 3", "some new trouble"),
        ("exit 3", "`sh` ended with code 3"),
    ):
        with pytest.raises(CommandFailed) as caught:
            link.run("sh", "-c", script)
        assert (caught.value.what, caught.value.code) == (what, 3)
    link.close()


def test_the_facts_of_a_robot(sshds: Sshds) -> None:
    """One round trip; what its login scripts print is kept apart."""
    home = start(sshds, "pi1", before="echo Welcome")
    (home.path / ".fleet/stacks/abc").mkdir(parents=True)
    link = Link(home.robot)
    seen = link.facts()
    link.close()
    assert (tuple(seen.fleet.stacks), seen.login.noise, seen.login.name) == (
        ("abc",),
        "Welcome",
        home.robot.user,
    )


def test_a_login_that_runs_no_commands_is_told_so(sshds: Sshds) -> None:
    """A restricted shell answers something else, and exits well."""
    server = sshds.start("pi1", options=("ForceCommand echo only git here >&2",))
    link = Link(server.robot())
    with pytest.raises(
        NotAsPlanned, match="the robot's shell did not run the probe: only git here"
    ) as caught:
        link.facts()
    assert "fab shell" in caught.value.cure
    link.close()


@pytest.mark.parametrize(
    ("command", "what", "cure"),
    [
        # What tcsh 6.24 says to the first lines of the probe.
        (
            "printf '/bin/sh: Event not found.\\nBadly placed () s.\\nsection: Command not found.\\n' >&2; exit 1",
            "the login shell on the robot is csh or tcsh",
            "chsh -s /bin/bash",
        ),
        (
            "echo 'This account is currently not available.'; exit 1",
            "the login's shell on the robot runs no commands",
            "usermod",
        ),
        (
            "echo 'sh: timeout: not found' >&2; exit 127",
            "the command timeout is missing on the robot",
            "apt-get install coreutils",
        ),
        ("echo 'sh: Zeile 1: gibt es nicht' >&2; exit 127", "a command is missing on the robot", "package"),
    ],
)
def test_a_login_that_cannot_run_the_probe_is_told_why(
    sshds: Sshds, command: str, what: str, cure: str
) -> None:
    """In one sentence, instead of a line of noise for each line of the script."""
    server = sshds.start("pi1", options=(f"ForceCommand {command}",))
    link = Link(server.robot())
    with pytest.raises(NotAsPlanned) as caught:
        link.facts()
    link.close()
    assert caught.value.what.startswith(what)
    assert "\n" not in caught.value.what
    assert cure in caught.value.cure


@pytest.mark.parametrize("where", ["", " >&2"], ids=["output", "errors"])
def test_a_probe_that_never_ends_is_not_read_to_its_end(sshds: Sshds, where: str) -> None:
    """A robot that lies, or a login script gone wild: it is told, and some megabytes are read."""
    home = start(sshds, "pi1", before=f"yes{where}")
    link = Link(home.robot)
    with pytest.raises(NotAsPlanned, match=r"printed more than 1.0 MB"):
        link.facts()
    link.close()
