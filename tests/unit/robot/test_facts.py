from __future__ import annotations

from typing import Any

import pytest

from fleet.robot.facts import SETTLED, Host, StackFacts
from tests.support.samples import NOW, container


@pytest.mark.parametrize(
    ("values", "completed", "healthy"),
    [
        ({"health": "healthy"}, False, True),
        ({"health": ""}, False, True),
        ({"health": "unhealthy"}, False, False),
        ({"health": "starting"}, False, False),
        ({"state": "exited", "health": "", "code": 0, "policy": "no"}, True, True),
        ({"state": "exited", "health": "", "code": 0, "policy": ""}, True, True),
        ({"state": "exited", "health": "", "code": 0, "policy": "on-failure"}, True, True),
        ({"state": "exited", "health": "", "code": 0, "policy": "unless-stopped"}, False, False),
        ({"state": "exited", "health": "", "code": 0, "policy": "always"}, False, False),
        ({"state": "exited", "health": "", "code": 7, "policy": "no"}, False, False),
        ({"state": "created", "health": "", "code": 0, "policy": "no"}, False, False),
        ({"state": "restarting", "health": "", "code": 1}, False, False),
        ({"state": "paused", "health": ""}, False, False),
    ],
)
def test_healthy_is_running_well_or_done(values: dict[str, Any], completed: bool, healthy: bool) -> None:
    """A container without a health check that runs is as well as it can say; a one-shot has to end with 0."""
    seen = container("abc", **values)
    assert (seen.completed, seen.healthy) == (completed, healthy)


@pytest.mark.parametrize(
    ("values", "looping"),
    [
        ({"restarts": 0, "since": NOW}, False),
        ({"restarts": 3, "since": NOW - SETTLED + 1}, True),
        ({"restarts": 3, "since": NOW - SETTLED}, False),
        ({"state": "restarting", "restarts": 0, "since": NOW - 1000}, True),
    ],
)
def test_a_container_that_docker_keeps_restarting_is_looping(values: dict[str, Any], looping: bool) -> None:
    """Between two crashes it is running; only its restarts and how long ago the last was tell."""
    assert container("abc", **values).looping(NOW) is looping


@pytest.mark.parametrize(
    ("values", "running"),
    [
        ({"containers": (container("abc"),)}, True),
        ({"containers": (container("abc"), container("abc", service="lidar"))}, True),
        ({"containers": (container("abc"), container("abc", service="lidar", health="unhealthy"))}, False),
        ({"containers": (container("old"),)}, False),
        ({"containers": (container("abc"), container("old", service="lidar"))}, False),
        ({"containers": (container("abc", service="lidar"),)}, False),
        ({"containers": ()}, False),
        ({"containers": (), "services": ()}, False),
    ],
)
def test_a_stack_runs_if_each_service_does_and_nothing_else(values: dict[str, Any], running: bool) -> None:
    """A service without a container, and a container of another release, are both wrong."""
    seen = StackFacts(**{"current": "abc", "services": ("talker",), **values})
    assert seen.running is running


@pytest.mark.parametrize(
    ("machine", "userland", "emulates", "platforms"),
    [
        ("aarch64", "arm64", (), ("linux/arm64",)),
        ("aarch64", "armhf", (), ("linux/arm/v7",)),
        ("armv7l", "armhf", (), ("linux/arm/v7",)),
        ("armv8l", "", (), ("linux/arm/v7",)),
        ("armv6l", "armhf", (), ()),
        ("aarch64", "", (), ("linux/arm64",)),
        ("aarch64", "64", (), ("linux/arm64",)),
        (
            "x86_64",
            "amd64",
            ("qemu-aarch64", "qemu-arm", "qemu-riscv64"),
            ("linux/amd64", "linux/arm64", "linux/arm/v7"),
        ),
        ("aarch64", "arm64", ("qemu-aarch64",), ("linux/arm64",)),
        ("riscv64", "riscv64", (), ()),
    ],
)
def test_platforms_are_those_of_the_userland_then_the_emulated(
    machine: str, userland: str, emulates: tuple[str, ...], platforms: tuple[str, ...]
) -> None:
    """A 64-bit kernel under a 32-bit system (Raspberry Pi OS on a Pi 4) runs 32-bit containers."""
    assert Host(machine=machine, userland=userland, emulates=emulates).platforms == platforms
