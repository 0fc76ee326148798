from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import pytest

from fleet.config.hardware import Hardware, Usb
from fleet.errors import NotReady
from fleet.plan.step import Bytes
from fleet.provision import hardware
from fleet.robot.hardware import UDEV_RULES
from tests.support.samples import PI, facts

if TYPE_CHECKING:
    from fleet.config.inventory import Robot

LIDAR = Usb(vendor="10C4", product="EA60", serial="0001")
RULES = """\
# Written by `fab provision`, from `udev:` in the inventory. What you add here is lost.
SUBSYSTEM=="video4linux", ATTR{index}=="0", KERNELS=="1-1.2", SYMLINK+="cam"
SUBSYSTEM=="tty", ATTRS{idVendor}=="10c4", ATTRS{idProduct}=="ea60", ATTRS{serial}=="0001", SYMLINK+="lidar"
SUBSYSTEM=="input", KERNEL=="event*", ATTRS{idVendor}=="054c", ATTRS{idProduct}=="09cc", SYMLINK+="pad"
"""
NAMES = {
    "lidar": LIDAR,
    "cam": Usb(kind="camera", port="1-1.2"),
    "pad": Usb(kind="input", vendor="054c", product="09cc"),
}
BOARD: dict[str, Any] = {"model": "Raspberry Pi 4 Model B Rev 1.4", "boot_folder": "/boot/firmware"}


def robot(**said: Any) -> Robot:  # noqa: ANN401  whatever hardware has
    return PI.model_copy(update={"hardware": Hardware(**said)})


def titles(of: Robot, **seen: object) -> list[str]:
    return [step.title for step in hardware.steps(of, facts(**seen))]


def test_nothing_is_said_and_nothing_is_done() -> None:
    """Not even on a robot that has rules of its own under our name."""
    assert titles(PI) == []
    assert titles(PI, udev_rules="# mine") == []


def test_rules_of_udev() -> None:
    """Vendor and product in small letters as the kernel has them; a camera's second node is left out."""
    assert hardware.udev_rules(NAMES) == RULES
    assert hardware.udev_rules({}) == ""


def test_rules_are_written_once() -> None:
    """With the very text that a person sees with --dry."""
    (step,) = hardware.steps(robot(udev=NAMES), facts())
    assert step.title == "name /dev/lidar, /dev/cam, /dev/pad (udev rules)"
    assert step.argv[-3:-1] == (UDEV_RULES, hashlib.sha256(RULES.encode()).hexdigest())
    assert isinstance(step.feed, Bytes)
    assert step.feed.data.decode() == RULES
    assert step.feed.label in RULES
    assert titles(robot(udev=NAMES), udev_rules=RULES.strip()) == []


def test_names_that_nobody_wants_any_more_go() -> None:
    """The inventory says all names that there are."""
    (step,) = hardware.steps(PI, facts(udev_rules=RULES.strip()))
    assert step.title == "remove the names of USB devices (udev rules)"
    assert (step.argv[-1], step.feed) == (UDEV_RULES, None)


def test_somebodys_rules_are_not_touched() -> None:
    """They could be what makes the robot work."""
    with pytest.raises(NotReady, match=r"99-fleet.rules on it is not fleet's") as refused:
        hardware.steps(robot(udev=NAMES), facts(udev_rules="# mine"))
    assert (
        refused.value.cure
        == f"rename it on the robot, such as `sudo mv {UDEV_RULES} /etc/udev/rules.d/99-own.rules`"
    )


def test_groups_of_the_login() -> None:
    """Only those that the login is not in; one usermod, which appends."""
    said, seen = robot(groups=["docker", "dialout", "i2c"]), facts(system_groups=("dialout", "docker", "i2c"))
    (step,) = hardware.steps(said, seen)
    assert step.title == "put pi into the groups dialout, i2c"
    assert step.argv == ("sudo", "-n", "usermod", "--append", "--groups", "dialout,i2c", "pi")
    assert titles(robot(groups=["docker"]), groups=("pi",)) == []


def test_a_group_that_does_not_exist() -> None:
    """A typing error is not made a group."""
    with pytest.raises(NotReady, match="group dialuot, which does not exist") as refused:
        hardware.steps(robot(groups=["dialuot"]), facts(system_groups=("root", "dialout")))
    assert refused.value.cure.startswith("did you mean 'dialout'?; correct `groups:` of pi1")


def test_interfaces_of_a_pi() -> None:
    """Those that are off, with the line for each; a proof reads the file afterwards."""
    said = robot(interfaces=["i2c", "spi", "serial", "i2c"])
    step, proof = hardware.steps(said, facts(**BOARD, interfaces=("spi",), raspi_config=True))
    assert step.title == "switch on i2c, serial, from the next boot on (raspi-config)"
    assert step.argv[-4:] == (
        "pi_interfaces",
        "/boot/firmware",
        "i2c=dtparam=i2c_arm=on",
        "serial=enable_uart=1",
    )
    assert proof.title == "prove that /boot/firmware/config.txt switches on i2c, serial"
    assert titles(said, **BOARD, interfaces=("i2c", "spi", "serial")) == []
    assert titles(said, **BOARD)[0].endswith("(config.txt)")


def test_interfaces_of_what_is_no_pi() -> None:
    """A Jetson has no config.txt."""
    with pytest.raises(NotReady, match="is for a Raspberry Pi, and it is NVIDIA Jetson") as refused:
        hardware.steps(robot(interfaces=["i2c"]), facts(model="NVIDIA Jetson Nano"))
    assert refused.value.cure == "remove `interfaces:` of pi1 in the inventory"
