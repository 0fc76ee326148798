from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

import pytest

from fleet.card import system
from fleet.card.system import System
from fleet.errors import DesktopError, UsageError
from tests.support.boot_partition import BOOKWORM, BULLSEYE, TRIXIE, UBUNTU, UBUNTU_26, boot_partition

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


@pytest.mark.parametrize(
    ("files", "found"),
    [
        (
            TRIXIE,
            System(
                kind="cloud-init",
                raspberry_pi_os=True,
                name="Raspberry Pi OS of 2025-11-24, with cloud-init",
            ),
        ),
        (
            UBUNTU,
            System(
                kind="cloud-init",
                raspberry_pi_os=False,
                name="Ubuntu or another system, with cloud-init",
            ),
        ),
        (
            UBUNTU_26,
            System(
                kind="cloud-init",
                raspberry_pi_os=False,
                name="Ubuntu or another system, with cloud-init",
            ),
        ),
        (
            BOOKWORM,
            System(
                kind="custom.toml",
                raspberry_pi_os=True,
                name="Raspberry Pi OS of 2024-11-19, with custom.toml",
            ),
        ),
        (
            BULLSEYE,
            System(
                kind="userconf.txt",
                raspberry_pi_os=True,
                name="Raspberry Pi OS of 2022-09-22, with userconf.txt",
            ),
        ),
    ],
    ids=["trixie", "ubuntu", "ubuntu 26.04", "bookworm", "bullseye"],
)
def test_the_card_tells_its_system(tmp_path: Path, files: Mapping[str, str], found: System) -> None:
    assert system.look(boot_partition(tmp_path / "boot", files)) == found


def without(files: Mapping[str, str], *names: str, **instead: str) -> dict[str, str]:
    kept = {name: text for name, text in files.items() if name not in names}
    return kept | {name.replace("_", "."): text for name, text in instead.items()}


IMAGER = (
    BOOKWORM["cmdline.txt"].strip() + " systemd.run=/boot/firstrun.sh systemd.run_success_action=reboot\n"
)


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        (without(UBUNTU, "user-data", "meta-data"), "is unknown: it has no user-data and no meta-data"),
        (without(BOOKWORM, cmdline_txt="root=/dev/mmcblk0p2\n"), "does not read custom.toml again"),
        (without(BULLSEYE, cmdline_txt="root=/dev/mmcblk0p2\n"), "does not read userconf.txt again"),
        (without(BOOKWORM, cmdline_txt=IMAGER), "has settings of the Raspberry Pi Imager (firstrun.sh)"),
        (without(BULLSEYE, issue_txt="Raspberry Pi reference 2021-05-07\n"), "is too old"),
        (without(TRIXIE, "config.txt"), "is not the boot partition of a Raspberry Pi: config.txt missing"),
        ({}, "config.txt and cmdline.txt missing"),
    ],
    ids=["unknown", "booted bookworm", "booted bullseye", "imager", "old", "no config.txt", "empty"],
)
def test_a_card_that_is_refused(tmp_path: Path, files: Mapping[str, str], reason: str) -> None:
    """The sentence has what was looked for, and the way out."""
    with pytest.raises(UsageError) as refused:
        system.look(boot_partition(tmp_path / "boot", files))
    assert reason in refused.value.what
    assert refused.value.cure


def test_the_first_bullseye_without_a_default_user(tmp_path: Path) -> None:
    """Its first boot had another program."""
    older = {"cmdline_txt": "root=PARTUUID=1-02 quiet init=/usr/lib/raspi-config/init_resize.sh\n"}
    assert system.look(boot_partition(tmp_path / "boot", without(BULLSEYE, **older))).kind == "userconf.txt"


def test_a_folder_that_is_no_card(tmp_path: Path) -> None:
    """None, a file, the other partition of the card."""
    (tmp_path / "file").touch()
    for name in ("nothing", "file"):
        with pytest.raises(UsageError, match="no such folder"):
            system.look(tmp_path / name)
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/os-release").touch()
    with pytest.raises(UsageError, match="the root file system of a card"):
        system.look(tmp_path)


def test_the_boot_partition_of_this_computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever develops on a Raspberry Pi has one too."""
    folder = boot_partition(tmp_path / "firmware", TRIXIE)
    (tmp_path / "link").symlink_to(folder)
    monkeypatch.setattr(system, "_own", lambda _: (folder,))
    for name in ("firmware", "link"):
        with pytest.raises(UsageError, match="the boot partition of this computer"):
            system.look(tmp_path / name)


def test_a_card_that_is_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = boot_partition(tmp_path / "boot", TRIXIE)
    real = os.statvfs(folder)
    fields = list(real)
    fields[8] |= os.ST_RDONLY
    monkeypatch.setattr(os, "statvfs", lambda _: os.statvfs_result(fields))
    with pytest.raises(DesktopError, match="is read-only"):
        system.look(folder)


def test_a_card_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worn one gives an error of the device."""
    folder = boot_partition(tmp_path / "boot", TRIXIE)

    def broken(path: Path, *_: object, **__: object) -> str:
        raise OSError(5, "Input/output error", str(path))

    monkeypatch.setattr(sys.modules["pathlib"].Path, "read_text", broken)
    with pytest.raises(DesktopError, match="cannot be read: Input/output error"):
        system.look(folder)
