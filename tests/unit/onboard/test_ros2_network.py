from __future__ import annotations

import os
import socket
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.ros import silence

if TYPE_CHECKING:
    from pathlib import Path

DOCKER = """#!/bin/sh
case $1 in
ps) [ -z "$BROKEN" ] || { echo 'permission denied' >&2; exit 1; }; echo a; echo b ;;
inspect) [ "$4" = a ] && printf '/nav-1 host\\n ROS_DOMAIN_ID=7\\n TOKEN=secret\\n PATH=/bin\\n'
    [ "$4" = b ] && printf '/web bridge\\n' ;;
esac
"""


def run(home: Path, **environment: str) -> str:
    docker = home.parent / "bin/docker"
    docker.write_text(DOCKER)
    docker.chmod(0o755)
    argv = ("sh", "-c", onboard.text("ros2_network.sh"))
    path = {"PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}", **environment}
    return subprocess.run(argv, env=path, capture_output=True, text=True, check=True, timeout=60).stdout


def test_what_it_prints_is_read(home: Path) -> None:
    """Where SSH arrived, the ports that are open now, and each container."""
    ports = [7400 + 250 * 96 + offset for offset in (10, 11)]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as two,
    ):
        for opened, port in zip((one, two), ports, strict=True):
            try:
                opened.bind(("127.0.0.1", port))
            except OSError:
                pytest.skip(f"port {port} is in use here")
        found = silence.read(run(home, SSH_CONNECTION="10.0.0.9 51234 10.0.0.2 22"))
    assert found.address == "10.0.0.2"
    assert found.domains[96] >= {10, 11}
    assert [(one.name, one.network, dict(one.settings)) for one in found.containers] == [
        ("nav-1", "host", {"ROS_DOMAIN_ID": "7"}),
        ("web", "bridge", {}),
    ]


def test_secrets_stay_on_the_robot(home: Path) -> None:
    """Of the variables of containers, only those about ROS are printed."""
    printed = run(home)
    assert "ROS_DOMAIN_ID=7" in printed
    assert "secret" not in printed


def test_without_docker(home: Path) -> None:
    """The rest is printed all the same."""
    printed = run(home, BROKEN="1")
    assert printed.endswith("== containers\n== end\n")
    assert "local_address" in printed
