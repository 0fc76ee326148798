"""Steps that set up what the inventory says about a robot's hardware: groups, names of USB devices, interfaces of a Pi."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet import onboard
from fleet.config.selection import did_you_mean
from fleet.errors import NotReady
from fleet.plan.step import Bytes, Step
from fleet.provision import whole_file
from fleet.provision.sudo import as_root
from fleet.robot import raspberry_pi
from fleet.robot.hardware import UDEV_RULES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.hardware import Usb
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts

_HEADING = "# Written by `fab provision`, from `udev:` in the inventory. What you add here is lost.\n"

_SUBSYSTEM = {
    "serial": ('SUBSYSTEM=="tty"',),
    # A camera has a second node, for metadata.
    "camera": ('SUBSYSTEM=="video4linux"', 'ATTR{index}=="0"'),
    "input": ('SUBSYSTEM=="input"', 'KERNEL=="event*"'),
}

_PROOF = """for line; do tr -d '\\r' <"$0" | grep -Eq "$line" || { echo "$0 has no line like $line" >&2; exit 1; }; done"""


def steps(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    """The steps after which the robot has what the inventory says; none if it has that.

    Raises:
        NotReady: a group does not exist, a file of rules is somebody's own, or the robot is no Raspberry Pi.

    """
    return (*_groups(robot, facts), *_udev(robot, facts), *_interfaces(robot, facts))


def udev_rules(names: Mapping[str, Usb]) -> str:
    """The text of `UDEV_RULES`, which gives each device its name in /dev; "" if there are none."""
    rules = "".join(
        ", ".join((*_match(usb), f'SYMLINK+="{name}"')) + "\n" for name, usb in sorted(names.items())
    )
    return _HEADING + rules if rules else ""


def _match(usb: Usb) -> tuple[str, ...]:
    # man 7 udev: ATTRS and KERNELS must match one and the same parent, here the USB device.
    parents = {
        "ATTRS{idVendor}": (usb.vendor or "").lower(),
        "ATTRS{idProduct}": (usb.product or "").lower(),
        "ATTRS{serial}": usb.serial,
        "KERNELS": usb.port,
    }
    return (*_SUBSYSTEM[usb.kind], *(f'{key}=="{value}"' for key, value in parents.items() if value))


def _groups(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    login, there = facts.login, facts.hardware.system_groups
    # Docker's own group is the business of `fleet.provision.steps`: it comes with Docker.
    missing = [group for group in robot.hardware.groups if group not in (*login.groups, "docker")]
    if unknown := next((group for group in missing if group not in there), ""):
        hint = did_you_mean(unknown, there)
        raise NotReady(
            f"the inventory puts {login.name} into the group {unknown}, which does not exist on it",
            cure=(f"{hint}; " if hint else "")
            + f"correct `groups:` of {robot.name} in the inventory, or `sudo groupadd --system {unknown}` on the robot",
        )
    if not missing:
        return ()
    argv = as_root(facts, "usermod", "--append", "--groups", ",".join(missing), login.name)
    return (Step(title=f"put {login.name} into the groups {', '.join(missing)}", argv=argv, limit=20.0),)


def _udev(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    names, there = robot.hardware.udev, facts.hardware.udev_rules
    rules = udev_rules(names)
    if there.strip() == rules.strip():
        return ()
    if there and not there.startswith(_HEADING.strip()):
        if not rules:
            return ()
        raise NotReady(
            f"{UDEV_RULES} on it is not fleet's",
            cure=f"rename it on the robot, such as `sudo mv {UDEV_RULES} {UDEV_RULES.replace('fleet', 'own')}`",
        )
    title = (
        f"name {', '.join(f'/dev/{name}' for name in names)}" if names else "remove the names of USB devices"
    )
    how = (whole_file.digest(rules.encode()), onboard.text("replace_file.sh")) if rules else ()
    return (
        Step(
            title=f"{title} (udev rules)",
            argv=as_root(facts, "sh", "-c", onboard.text("udev_rules.sh"), "udev_rules", UDEV_RULES, *how),
            feed=Bytes(label=rules.removeprefix(_HEADING).strip(), data=rules.encode()) if rules else None,
            limit=30.0,
            cure="`sudo udevadm control --reload && sudo systemctl status systemd-udevd` on the robot shows more",
        ),
    )


def _interfaces(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    hardware = facts.hardware
    off = [name for name in dict.fromkeys(robot.hardware.interfaces) if name not in hardware.interfaces]
    if not off:
        return ()
    if not hardware.boot_folder:
        raise NotReady(
            f"`interfaces:` is for a Raspberry Pi, and it is {hardware.model or 'none'}: it has no config.txt in /boot",
            cure=f"remove `interfaces:` of {robot.name} in the inventory",
        )
    lines, patterns = raspberry_pi.lines(hardware.model), raspberry_pi.patterns(hardware.model)
    script = ("sh", "-c", onboard.text("pi_interfaces.sh"), "pi_interfaces", hardware.boot_folder)
    how = "raspi-config" if hardware.raspi_config else "config.txt"
    config = f"{hardware.boot_folder}/config.txt"
    return (
        Step(
            title=f"switch on {', '.join(off)}, from the next boot on ({how})",
            argv=as_root(facts, *script, *(f"{name}={lines[name]}" for name in off)),
            limit=60.0,
        ),
        Step(
            title=f"prove that {config} switches on {', '.join(off)}",
            argv=("sh", "-c", _PROOF, config, *(patterns[name] for name in off)),
            limit=20.0,
        ),
    )
