"""Which platforms does fleet know, and what do Docker, dpkg, the kernel and QEMU call them?"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Platform:
    """One platform by all of its names.

    ``name`` is Docker's, ``debian`` is dpkg's, ``machines`` are those that ``uname -m`` prints, and ``emulator`` is the
    handler that QEMU's packages register with the kernel (binfmt_misc).
    """

    name: str
    debian: str
    machines: tuple[str, ...]
    emulator: str


ARM64 = Platform(
    name="linux/arm64", debian="arm64", machines=("aarch64", "arm64"), emulator="qemu-aarch64"
)  # macOS prints arm64
ARMV7 = Platform(
    name="linux/arm/v7", debian="armhf", machines=("armv7l", "armv8l"), emulator="qemu-arm"
)  # a 64-bit kernel prints armv8l to a 32-bit program
AMD64 = Platform(name="linux/amd64", debian="amd64", machines=("x86_64",), emulator="qemu-x86_64")

PLATFORMS = (ARM64, ARMV7, AMD64)

NAMES = tuple(platform.name for platform in PLATFORMS)
"""Docker's names, the ones that an inventory takes."""

DEBIAN_ARCHITECTURES = {platform.name: platform.debian for platform in PLATFORMS}
"""Docker's name -> dpkg's."""

EMULATORS = {platform.name: platform.emulator for platform in PLATFORMS}
"""Docker's name -> QEMU's handler."""

PLATFORM_OF_EMULATOR = {platform.emulator: platform.name for platform in PLATFORMS}
"""QEMU's handler -> Docker's name."""

PLATFORM_OF_MACHINE = {
    machine: platform.name for platform in PLATFORMS for machine in (platform.debian, *platform.machines)
}
"""What dpkg or the kernel says -> Docker's name."""
