"""Which platforms can this desktop run, by itself or by emulation?

Platforms are named as Docker names them: ``linux/arm64``. Debian and the kernel have names of their own.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

BINFMT = Path("/proc/sys/fs/binfmt_misc")

DEBIAN_ARCHITECTURES = {"linux/amd64": "amd64", "linux/arm64": "arm64", "linux/arm/v7": "armhf"}
"""Platform -> what dpkg calls it."""

_MACHINES = {
    "x86_64": "linux/amd64",
    "aarch64": "linux/arm64",
    "arm64": "linux/arm64",
    "armv7l": "linux/arm/v7",
    "armv8l": "linux/arm/v7",
}
_HANDLERS = {"linux/amd64": "qemu-x86_64", "linux/arm64": "qemu-aarch64", "linux/arm/v7": "qemu-arm"}


def desktop_platform() -> str:
    """The platform this desktop runs without emulation."""
    machine = os.uname().machine
    return _MACHINES.get(machine, f"linux/{machine}")


def emulates(platform: str, *, binfmt: Path = BINFMT) -> bool:
    """Whether the kernel hands this platform's programs to an emulator, in containers too.

    In a container the emulator's file is missing: only a handler with flag F, which opened it at registration, works.
    """
    try:
        lines = (binfmt / _HANDLERS[platform]).read_text().splitlines()
    except (OSError, KeyError):
        return False
    flags = next((line.removeprefix("flags:") for line in lines if line.startswith("flags:")), "")
    return "enabled" in lines and "F" in flags


def runs(platform: str) -> bool:
    """Whether this desktop runs programs of that platform, natively or by emulation."""
    return platform == desktop_platform() or _is_native_32_bit(platform) or emulates(platform)


def _is_native_32_bit(platform: str) -> bool:
    """Many 64-bit ARM processors run 32-bit programs themselves; arch-test tries one."""
    if (desktop_platform(), platform) != ("linux/arm64", "linux/arm/v7"):
        return False
    try:
        return (
            subprocess.run(("arch-test", "armhf"), capture_output=True, timeout=20, check=False).returncode
            == 0
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
