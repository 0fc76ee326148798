"""Which platforms can this desktop run, by itself or by emulation?

Platforms have Docker's names here: ``linux/arm64``. `fleet.platforms` has the other names.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from fleet.platforms import ARM64, ARMV7, EMULATORS, PLATFORM_OF_MACHINE

BINFMT = Path("/proc/sys/fs/binfmt_misc")


def desktop_platform() -> str:
    """The platform this desktop runs without emulation."""
    machine = os.uname().machine
    return PLATFORM_OF_MACHINE.get(machine, f"linux/{machine}")


def emulates(platform: str, *, binfmt: Path = BINFMT) -> bool:
    """Whether the kernel hands this platform's programs to an emulator, in containers too.

    In a container the emulator's file is missing: only a handler with flag F, which opened it at registration, works.
    """
    try:
        lines = (binfmt / EMULATORS[platform]).read_text().splitlines()
    except (OSError, KeyError):
        return False
    flags = next((line.removeprefix("flags:") for line in lines if line.startswith("flags:")), "")
    return "enabled" in lines and "F" in flags


def runs(platform: str) -> bool:
    """Whether this desktop runs programs of that platform, natively or by emulation."""
    return platform == desktop_platform() or _is_native_32_bit(platform) or emulates(platform)


def _is_native_32_bit(platform: str) -> bool:
    """Many 64-bit ARM processors run 32-bit programs themselves; arch-test tries one."""
    if (desktop_platform(), platform) != (ARM64.name, ARMV7.name):
        return False
    try:
        return (
            subprocess.run(
                ("arch-test", ARMV7.debian), capture_output=True, timeout=20, check=False
            ).returncode
            == 0
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
