from __future__ import annotations

import os
import subprocess
from typing import TYPE_CHECKING

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path

DOCKER = """#!/bin/sh
case $1 in
ps) printf '%s\\n' $CONTAINERS ;;
inspect)
    case $3 in
    *Name*) echo "== name-of-$4" ;;
    *)
        case $4 in *-host*) echo network=host ;; *) echo "network=$4" ;; esac
        case $4 in wanted*) echo ROS_MASTER_URI=http://localhost:11311 ;; *) echo ROS_MASTER_URI=http://other:11311 ;; esac
        echo "HOSTNAME=$4"
        ;;
    esac
    ;;
exec)
    case $* in
    *'import sys'*) [ "$2" != nothing ] ;;
    *)
        echo "$*" | tr '\\n' ' '
        echo
        [ "$2" = --interactive ] && cat && echo
        case $5 in *bare*) exit 3 ;; *broken*) exit 1 ;; *unpublished*) exit 4 ;; esac
        ;;
    esac
    ;;
esac
"""


def hear(home: Path, containers: str) -> subprocess.CompletedProcess[str]:
    docker = home.parent / "bin/docker"
    docker.write_text(DOCKER)
    docker.chmod(0o755)
    variable = "ROS_MASTER_URI=http://localhost:11311"
    return subprocess.run(
        ("sh", "-c", onboard.text("hear.sh"), "hear", variable, "print(1)", "/time", "--all"),
        env={"PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}", "CONTAINERS": containers},
        input="beat",
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def tried(home: Path, containers: str) -> tuple[int, list[str]]:
    """The code, and the containers whose names were printed."""
    done = hear(home, containers)
    names = [line for line in done.stdout.splitlines() if line.startswith("== ")]
    return done.returncode, [name.removeprefix("== name-of-") for name in names]


def test_the_first_that_can(home: Path) -> None:
    """A container without Python is left out, one without ROS is tried; the program gets the input and the arguments."""
    assert tried(home, "nothing bare good other") == (0, ["bare", "good"])
    done = hear(home, "nothing bare good other")
    assert "good python3 -c print(1) /time --all" in done.stdout
    assert "FASTDDS_BUILTIN_TRANSPORTS=UDPv4" in done.stdout
    assert "beat" in done.stdout


def test_containers_that_see_what_the_inventory_means_come_first(home: Path) -> None:
    """Another one may have a master of its own, with the same topic."""
    assert tried(home, "good good-host wanted-good wanted-good-host") == (0, ["wanted-good-host"])
    assert tried(home, "good wanted-bare-host") == (0, ["wanted-bare-host", "good"])


def test_a_topic_that_nobody_publishes_there(home: Path) -> None:
    """Another container may see it, but not one with the same network and the same variables."""
    assert tried(home, "unpublished good") == (0, ["unpublished", "good"])
    assert tried(home, "unpublished-host unpublished-host2 good-host") == (
        4,
        ["unpublished-host", "unpublished-host"],
    )
    assert tried(home, "unpublished-host wanted-good-host") == (0, ["wanted-good-host"])


def test_codes(home: Path) -> None:
    """The program's own; or 4 or 3 if none could, and then the container whose reason says most comes last."""
    assert tried(home, "broken good") == (1, ["broken"])
    assert tried(home, "nothing bare") == (3, ["bare", "bare"])
    assert tried(home, "bare1 bare2") == (3, ["bare1", "bare2", "bare1"])
    assert tried(home, "bare unpublished bare2") == (4, ["bare", "unpublished", "bare2", "unpublished"])
    assert tried(home, "") == (3, [])
