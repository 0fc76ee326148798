"""Boot partitions of freshly written cards, as far as the program reads them: the files of the images, by system."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_CMDLINE = (
    "console=serial0,115200 console=tty1 root=PARTUUID=6b6bd2ba-02 rootfstype=ext4 fsck.repair=yes rootwait"
)
_FIRST_BOOT = f"{_CMDLINE} quiet init=/usr/lib/raspberrypi-sys-mods/firstboot\n"
_ISSUE = "Raspberry Pi reference {}\nGenerated using pi-gen, https://github.com/RPi-Distro/pi-gen, 5c4a1b2, stage2\n"

TRIXIE = {
    "config.txt": "dtparam=audio=on\nauto_initramfs=1\n",
    "cmdline.txt": f"{_CMDLINE} ds=nocloud;i=rpi-imager\n",
    "issue.txt": _ISSUE.format("2025-11-24"),
    "user-data": "#cloud-config\n# hostname: raspberrypi\n",
    "meta-data": "dsmode: local\ninstance_id: rpios-image\n",
    "network-config": "# network:\n#   version: 2\n",
}
BOOKWORM = {
    "config.txt": "dtparam=audio=on\nauto_initramfs=1\n",
    "cmdline.txt": _FIRST_BOOT,
    "issue.txt": _ISSUE.format("2024-11-19"),
}
BULLSEYE = {
    "config.txt": "dtparam=audio=on\n",
    "cmdline.txt": _FIRST_BOOT,
    "issue.txt": _ISSUE.format("2022-09-22"),
}
UBUNTU = {
    "config.txt": "[all]\nkernel=vmlinuz\n",
    "cmdline.txt": "console=tty1 root=LABEL=writable rootfstype=ext4 rootwait fixrtc\n",
    "user-data": "#cloud-config\nchpasswd:\n  expire: true\n  list:\n  - ubuntu:ubuntu\n",
    "meta-data": "dsmode: local\ninstance_id: cloud-image\n",
    "network-config": "version: 2\nethernets:\n  eth0:\n    dhcp4: true\n    optional: true\n",
}

UBUNTU_26 = {
    "config.txt": "[all]\nkernel=vmlinuz\nos_prefix=current/\n[tryboot]\nos_prefix=new/\n",
    "current/cmdline.txt": UBUNTU["cmdline.txt"],
    **{name: UBUNTU[name] for name in ("user-data", "meta-data", "network-config")},
}
"""Since 25.10."""


def boot_partition(folder: Path, files: Mapping[str, str]) -> Path:
    """A folder with these files."""
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(content)
    return folder
