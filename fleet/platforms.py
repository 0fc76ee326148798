"""Which platforms are there, and what do others call them?"""

from __future__ import annotations

PLATFORM_OF_MACHINE = {
    "arm64": "linux/arm64",
    "aarch64": "linux/arm64",
    "armhf": "linux/arm/v7",
    "armv7l": "linux/arm/v7",
    "amd64": "linux/amd64",
    "x86_64": "linux/amd64",
}
PLATFORM_OF_EMULATOR = {
    "qemu-aarch64": "linux/arm64",
    "qemu-arm": "linux/arm/v7",
    "qemu-x86_64": "linux/amd64",
}
