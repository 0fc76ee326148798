from __future__ import annotations

import pytest

from fleet.robot.facts import Container, Host


@pytest.mark.parametrize(
    ("state", "status", "healthy"),
    [
        ("running", "Up 3 minutes (healthy)", True),
        ("running", "Up 3 minutes", True),
        ("running", "Up 3 minutes (unhealthy)", False),
        ("running", "Up 3 seconds (health: starting)", False),
        ("exited", "Exited (0) 3 seconds ago", False),
        ("restarting", "Restarting (1) 3 seconds ago", False),
    ],
)
def test_healthy_is_running_and_not_said_to_be_otherwise(state: str, status: str, healthy: bool) -> None:
    """A container without a healthcheck that runs is as well as it can say."""
    assert Container(name="", service="", release="", stack="", state=state, status=status).healthy is healthy


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
