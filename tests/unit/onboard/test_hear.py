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
inspect) echo "== name-of-$4" ;;
exec)
    case $* in
    *'import sys'*) [ "$2" != nothing ] ;;
    *)
        echo "$*" | tr '\\n' ' '
        echo
        [ "$2" = --interactive ] && cat && echo
        case $5 in bare) exit 3 ;; broken) exit 1 ;; esac
        ;;
    esac
    ;;
esac
"""


def hear(home: Path, containers: str) -> subprocess.CompletedProcess[str]:
    docker = home.parent / "bin/docker"
    docker.write_text(DOCKER)
    docker.chmod(0o755)
    return subprocess.run(
        ("sh", "-c", onboard.text("hear.sh"), "hear", "print(1)", "/time", "--all"),
        env={"PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}", "CONTAINERS": containers},
        input="beat",
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def test_the_first_that_can(home: Path) -> None:
    """A container without Python is left out, one without ROS is tried; the program gets the input and the arguments."""
    done = hear(home, "nothing bare good other")
    assert done.returncode == 0
    assert [line for line in done.stdout.splitlines() if line.startswith("==")] == [
        "== name-of-bare",
        "== name-of-good",
    ]
    assert "good python3 -c print(1) /time --all" in done.stdout
    assert "FASTDDS_BUILTIN_TRANSPORTS=UDPv4" in done.stdout
    assert "beat" in done.stdout


def test_codes(home: Path) -> None:
    """The program's own, or 3 if there is no container with ROS."""
    assert hear(home, "broken good").returncode == 1
    assert hear(home, "nothing bare").returncode == 3
    assert hear(home, "").returncode == 3
