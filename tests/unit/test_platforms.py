from __future__ import annotations

from typing import get_args

import pytest

from fleet import platforms
from fleet.config.inventory import Platform


def test_an_inventory_takes_the_platforms_that_fleet_knows() -> None:
    """A type cannot be computed, so the inventory writes them out again."""
    assert get_args(Platform) == platforms.NAMES


@pytest.mark.parametrize(
    ("machine", "platform"),
    [
        *(("aarch64", "linux/arm64"), ("arm64", "linux/arm64")),
        *(("armv7l", "linux/arm/v7"), ("armv8l", "linux/arm/v7"), ("armhf", "linux/arm/v7")),
        *(("x86_64", "linux/amd64"), ("amd64", "linux/amd64")),
    ],
)
def test_what_the_kernel_and_dpkg_say(machine: str, platform: str) -> None:
    """A 64-bit kernel calls itself armv8l to 32-bit programs."""
    assert platforms.PLATFORM_OF_MACHINE[machine] == platform


def test_no_name_means_two_platforms() -> None:
    """A name that stands twice would hide one of them."""
    names = [name for one in platforms.PLATFORMS for name in {one.debian, *one.machines}]
    assert len(names) == len(set(names)) == len(platforms.PLATFORM_OF_MACHINE)
    for table in (platforms.EMULATORS, platforms.PLATFORM_OF_EMULATOR, platforms.DEBIAN_ARCHITECTURES):
        assert len(table) == len(platforms.PLATFORMS)
