from __future__ import annotations

from collections import defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.robot.hardware import Hardware, l4t, parse


def parsed(**sections: str) -> Hardware:
    return parse(defaultdict(str, sections))


@pytest.mark.parametrize(
    ("said", "version"),
    [
        (
            "# R32 (release), REVISION: 7.2, GCID: 30192233, BOARD: t186ref, EABI: aarch64, DATE: Sun Apr 17 09:53:50 UTC 2022",
            "32.7.2",
        ),
        ("# R35 (release), REVISION: 4.1, GCID: 33958178, BOARD: t186ref, EABI: aarch64", "35.4.1"),
        ("# R36 (release), REVISION: 4.0, GCID: 37537400, BOARD: generic, EABI: aarch64", "36.4.0"),
        ("36.4.3-20250107174145", "36.4.3"),
        ("", ""),
        ("a stranger", ""),
        ("# R36 (release), REVISION: " + "9" * 99, "36.999"),
    ],
)
def test_the_version_of_nvidias_linux(said: str, version: str) -> None:
    """From lines of /etc/nv_tegra_release as Jetsons have them, and from the version of nvidia-l4t-core."""
    assert l4t(said) == version


def test_a_jetson() -> None:
    """Every section ends in the fact of its name."""
    seen = parsed(
        model="NVIDIA Jetson Orin Nano Developer Kit",
        l4t="# R36 (release), REVISION: 4.0, GCID: 37537400",
        raw="no",
        toolkit="/usr/bin/nvidia-ctk",
        cdi="spec\nname 0\nname all\nkind nvidia.com/gpu\nspec\nkind vendor.com/arm\nname left",
        devices="/dev/ttyUSB0\n/dev/serial/by-id/usb-1a86_USB_Serial-if00-port0",
    )
    assert seen == Hardware(
        model="NVIDIA Jetson Orin Nano Developer Kit",
        l4t="36.4.0",
        raw_table=False,
        toolkit=True,
        cdi=("nvidia.com/gpu=0", "nvidia.com/gpu=all", "vendor.com/arm=left"),
        devices=("/dev/ttyUSB0", "/dev/serial/by-id/usb-1a86_USB_Serial-if00-port0"),
    )
    assert (seen.l4t_major, seen.lacks_raw_table) == ("36", True)


def test_a_raspberry_pi() -> None:
    """The lines of config.txt become the interfaces that are on."""
    seen = parsed(
        model="Raspberry Pi 4 Model B Rev 1.4",
        raw="unused",
        pi="/boot/firmware\n/usr/bin/raspi-config\nconsole=tty1 root=x\ndtparam=i2c_arm=on\nenable_uart=1",
        reboot=" i2c serial\n serial",
        udev="# rules",
        groups="root\ndialout\ni2c",
    )
    assert seen == Hardware(
        model="Raspberry Pi 4 Model B Rev 1.4",
        raw_table=True,
        boot_folder="/boot/firmware",
        raspi_config=True,
        interfaces=("i2c", "serial"),
        reboot_for=("i2c", "serial"),
        udev_rules="# rules",
        system_groups=("root", "dialout", "i2c"),
    )


def test_a_pi_without_raspi_config() -> None:
    """Its line is empty."""
    seen = parsed(pi="/boot\n\nconsole=serial0,115200 root=x\nenable_uart=1\ndtparam=spi=on")
    assert (seen.boot_folder, seen.raspi_config, seen.interfaces) == ("/boot", False, ("spi",))


@pytest.mark.parametrize(
    ("raw", "version", "lacks"),
    [
        ("no", "", True),
        ("yes", "36.4.0", False),
        ("unused", "", False),
        ("", "", False),
        ("", "36.4.0", True),
    ],
)
def test_the_raw_table(raw: str, version: str, lacks: bool) -> None:
    """What is not known is assumed to be missing on Jetsons only."""
    assert Hardware(raw_table=parsed(raw=raw).raw_table, l4t=version).lacks_raw_table == lacks


NAMES = ("model", "l4t", "raw", "toolkit", "cdi", "devices", "pi", "reboot", "udev", "groups")


@given(st.dictionaries(st.sampled_from(NAMES), st.text(max_size=200)))
def test_a_strangers_answer_is_no_error(said: dict[str, str]) -> None:
    """Whatever it prints, there are facts."""
    seen = parse(defaultdict(str, said))
    assert all(path.startswith("/dev/") for path in seen.devices)
    assert len(seen.model) <= 200


def test_there_are_not_more_devices_than_a_robot_has() -> None:
    """A million lines would fill the memory of this computer."""
    assert len(parsed(devices="/dev/x\n" * 9000).devices) == 5000
