"""Which system is on a card, and so which files does its first boot read? Its boot partition tells."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fleet.card import cloud_init
from fleet.errors import DesktopError, UsageError

if TYPE_CHECKING:
    from pathlib import Path

Kind = Literal["cloud-init", "custom.toml", "userconf.txt"]

_IMAGE = re.compile(r"Raspberry Pi reference (\d{4}-\d\d-\d\d)")
"""The first line of ``issue.txt``, which pi-gen writes (https://github.com/RPi-Distro/pi-gen)."""

_NO_DEFAULT_USER = "2022-04-04"
"""The first Raspberry Pi OS without a default user, and with ``userconf.txt``."""

_FIRST_BOOT = "raspberrypi-sys-mods/firstboot"
"""In ``cmdline.txt`` until the first boot, which reads ``custom.toml`` since bookworm."""

_FIRST_BOOTS = (_FIRST_BOOT, "raspi-config/init_resize.sh")
"""In ``cmdline.txt`` until the first boot of bullseye, by its age."""

CMDLINES = ("cmdline.txt", "current/cmdline.txt")
"""The kernel's parameters. Ubuntu has them in a folder since 25.10, which goes before
(https://canonical-ubuntu-boards.readthedocs-hosted.com/en/latest/explanations/piboot-ab)."""

_IMAGER = "firstrun.sh"
"""A script that the Raspberry Pi Imager 1 writes for settings, and lets ``cmdline.txt`` run at the first boot."""

_MOUNTED = (
    "`lsblk -o NAME,LABEL,MOUNTPOINTS` shows where the card's partition bootfs or system-boot is mounted"
)


@dataclass(frozen=True, kw_only=True)
class System:
    """The system of a card: what its first boot reads, and whether it is Raspberry Pi OS."""

    kind: Kind
    raspberry_pi_os: bool
    name: str


def look(folder: Path) -> System:
    """Find out which system a boot partition belongs to.

    Raises:
        UsageError: there is no boot partition of a card, it is this computer's own, or its system is too old or unknown.
        DesktopError: it cannot be read or written.

    """
    try:
        _check(folder)
        return _system(folder)
    except OSError as problem:
        cure = "write the card again; if that does not help, use another card"
        raise DesktopError(f"{folder} cannot be read: {problem.strerror}", cure=cure) from None


def _check(folder: Path) -> None:
    """Refuse what is not the boot partition of a card."""
    if not folder.is_dir():
        raise UsageError(f"--boot {folder}: no such folder", cure=_MOUNTED)
    if folder.resolve() in {path.resolve() for path in _own(folder) if path.exists()}:
        cure = "name the boot partition of the robot's card: " + _MOUNTED
        raise UsageError(f"{folder} is the boot partition of this computer", cure=cure)
    if (folder / "etc/os-release").exists():
        cure = f"the boot partition is the small one beside it: {_MOUNTED}"
        raise UsageError(f"{folder} is the root file system of a card", cure=cure)
    there = {name for name in ("config.txt", *CMDLINES) if (folder / name).is_file()}
    missing = [] if "config.txt" in there else ["config.txt"]
    missing += [] if there.intersection(CMDLINES) else ["cmdline.txt"]
    if missing:
        what = f"{folder} is not the boot partition of a Raspberry Pi: {' and '.join(missing)} missing"
        raise UsageError(what, cure=_MOUNTED)
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        cure = "slide the card's lock up, or mount it again: `sudo mount -o remount,rw FOLDER`"
        raise DesktopError(f"{folder} is read-only", cure=cure)
    if not os.access(folder, os.W_OK):
        raise DesktopError(
            f"{folder} may not be written by you", cure="mount the card as yourself, or use sudo"
        )


def _own(folder: Path) -> tuple[Path, ...]:
    root = type(folder)("/")
    return (root / "boot/firmware", root / "boot", root / "boot/efi")


def _system(folder: Path) -> System:
    found = _IMAGE.search(_text(folder / "issue.txt"))
    date = found[1] if found else ""
    name = f"Raspberry Pi OS of {date}" if date else "Ubuntu or another system"
    if any((folder / file).is_file() for file in (cloud_init.USER_DATA, cloud_init.META_DATA)):
        return System(kind="cloud-init", raspberry_pi_os=bool(date), name=f"{name}, with cloud-init")
    if not date:
        raise UsageError(
            f"the system of the card at {folder} is unknown: it has no user-data and no meta-data (cloud-init), and no issue.txt that says Raspberry Pi",
            cure="write Raspberry Pi OS or Ubuntu for the Raspberry Pi on it; other systems are set up by hand, then `fab trust`",
        )
    bookworm = "auto_initramfs" in _text(folder / "config.txt")
    if not bookworm and date < _NO_DEFAULT_USER:
        raise UsageError(f"{name} on the card at {folder} is too old", cure="write a newer one on the card")
    if _IMAGER in _text(folder / "cmdline.txt"):
        raise UsageError(
            f"the card at {folder} has settings of the Raspberry Pi Imager ({_IMAGER}), which would replace ours",
            cure="write the card again, without the Imager's settings",
        )
    kind: Kind = "custom.toml" if bookworm else "userconf.txt"
    cmdline = _text(folder / "cmdline.txt")
    if not any(first in cmdline for first in ((_FIRST_BOOT,) if bookworm else _FIRST_BOOTS)):
        what = f"{name} on the card at {folder} has booted already (cmdline.txt says so), and does not read {kind} again"
        raise UsageError(what, cure="write the card again; or change the robot over SSH")
    return System(kind=kind, raspberry_pi_os=True, name=f"{name}, with {kind}")


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
