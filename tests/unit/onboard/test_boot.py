from __future__ import annotations

import fcntl
import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path

DOCKER = """#!/bin/sh
case "$*" in
    events*) printf '%s\n' $EVENTS ;;
    "ps "*project=nav*) cat "$HOME/ended" 2>/dev/null ;;
    inspect*) cat "$HOME/inspected" ;;
    compose*) echo "$PWD: $*" >>"$HOME/asked" ;;
    start*) echo "$*" >>"$HOME/asked" ;;
esac
"""


class Robot:
    """A robot with a stack ``nav`` that is systemd's, and ``cam`` that is Docker's; both have ended."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.fleet = home / ".fleet"
        for name in ("nav", "cam"):
            release = self.fleet / "stacks" / name / "releases/aaa"
            release.mkdir(parents=True)
            (release / "services").write_text("planner=always\ndriver=on-failure\njob=no\n")
            (release / "compose.yaml").write_text("{}")
            (release.parents[1] / "current").symlink_to("releases/aaa")
        self.nav = self.fleet / "stacks/nav"
        (self.nav / "releases/aaa/boot").write_text("systemd\n")
        for name, script in {"docker": DOCKER, "timedatectl": "#!/bin/sh\necho ${CLOCK-yes}\n"}.items():
            (home.parent / "bin" / name).write_text(script)
            (home.parent / "bin" / name).chmod(0o755)

    def boots(self, *, again: bool = False, **environment: str) -> str:
        """What the unit's script prints in one look."""
        run = self.home.parent / "run"
        run.mkdir(exist_ok=True)
        if not again:
            (run / "started").unlink(missing_ok=True)
        argv = (str(self.home.parent / "bin/sh"), "-c", onboard.text("boot.sh"), "boot")
        environment = {
            "PATH": f"{self.home.parent / 'bin'}:{os.environ['PATH']}",
            "HOME": str(self.home),
            "RUNTIME_DIRECTORY": str(run),
            "FLEET_PASSES": "1",
            "FLEET_EVERY": "0",
            "FLEET_CLOCK": "1",
            **environment,
        }
        done = subprocess.run(argv, env=environment, capture_output=True, text=True, timeout=30, check=True)
        return done.stdout + done.stderr

    @property
    def asked(self) -> list[str]:
        """What Docker was asked to do."""
        path = self.home / "asked"
        return path.read_text().splitlines() if path.exists() else []


@pytest.fixture
def robot(home: Path) -> Robot:
    return Robot(home)


def test_the_current_release_is_started_at_power_on(robot: Robot) -> None:
    """Once, and only that of a stack that is systemd's."""
    assert "start releases/aaa of nav" in robot.boots()
    (started,) = robot.asked
    assert started == (
        f"{robot.nav}/releases/aaa: compose --project-name nav --file compose.yaml up --detach --no-build --pull never"
    )
    robot.boots(again=True)
    assert len(robot.asked) == 1


def test_the_clock_is_waited_for_and_not_for_ever(robot: Robot) -> None:
    """A robot without a network has no time server, and starts too."""
    assert "clock" not in robot.boots()
    assert "the clock is not synchronized after 1 s: starting anyway" in robot.boots(CLOCK="no")
    assert len(robot.asked) == 2


@pytest.mark.parametrize("change", ["stopped", "removed", "docker"])
def test_what_is_not_to_run_is_not_started(robot: Robot, change: str) -> None:
    """After `fab stop`, `fab remove`, and a rollback to a release that is Docker's: the unit needs no change."""
    (robot.home / "ended").write_text("one\n")
    (robot.home / "inspected").write_text("one planner 1 aaa\n")
    if change == "stopped":
        (robot.nav / "stopped").write_text("")
    elif change == "removed":
        (robot.nav / "current").unlink()
    else:
        (robot.nav / "releases/aaa/boot").unlink()
    assert (robot.boots(), robot.asked) == ("", [])


def test_what_has_ended_is_started_again_as_its_policy_says(robot: Robot) -> None:
    """Of the current release; a job that is done stays done."""
    lines = (
        "one planner 0 aaa",
        "two driver 1 aaa",
        "three driver 0 aaa",
        "four job 1 aaa",
        "five planner 1 old",
    )
    (robot.home / "ended").write_text("one\n")
    (robot.home / "inspected").write_text("".join(f"{line}\n" for line in lines))
    robot.boots()
    assert robot.asked[1:] == ["start one", "start two"]


def test_what_a_person_has_stopped_stays_stopped(robot: Robot) -> None:
    """As with Docker's policies: `docker stop` is no crash. Once it has run again, its next end counts."""
    (robot.home / "ended").write_text("one\n")
    inspected = robot.home / "inspected"
    inspected.write_text("one planner 137 aaa 2026-11-28T12:00:00Z\n")
    assert "somebody has stopped one" in robot.boots(EVENTS="start stop")
    assert robot.boots(again=True) == ""  # Docker forgets the event after a while
    assert len(robot.asked) == 1
    inspected.write_text("one planner 1 aaa 2026-11-28T12:30:00Z\n")
    robot.boots(again=True, EVENTS="stop start")
    assert robot.asked[1:] == ["start one"]


def test_retries_are_limited_as_the_policy_says(robot: Robot) -> None:
    """`restart: on-failure:2`: for each container, until the next power-on."""
    (robot.nav / "releases/aaa/services").write_text("planner=on-failure:2\ndriver=always\n")
    (robot.home / "ended").write_text("one\n")
    (robot.home / "inspected").write_text("one planner 1 aaa at\ntwo driver 1 aaa at\n")
    robot.boots(FLEET_PASSES="4")
    assert [robot.asked.count(f"start {name}") for name in ("one", "two")] == [2, 4]


def test_while_a_swap_is_at_work_nothing_is_started(robot: Robot) -> None:
    """It holds the lock, and knows better what shall run; the next look is five seconds later."""
    robot.boots()
    (robot.home / "ended").write_text("one\n")
    (robot.home / "inspected").write_text("one planner 1 aaa\n")
    with (robot.fleet / "lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        robot.boots(again=True)
    assert len(robot.asked) == 1


def test_the_unit_waits_for_network_and_clock() -> None:
    """As systemd names them; it runs as the login, and is started again if it ends."""
    unit = onboard.source("boot.service")
    assert "After=docker.service network-online.target time-sync.target fleet-finish.service\n" in unit
    assert "Wants=docker.service network-online.target time-sync.target\n" in unit
    assert {"User=LOGIN", "Restart=always", "WantedBy=multi-user.target"} <= set(unit.splitlines())
