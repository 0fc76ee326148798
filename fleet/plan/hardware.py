"""Has the robot what a release wants: runtimes, the GPU, devices? Docker would say so only after the old one was stopped."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

from fleet.errors import NotReady

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from typing import Any

    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.robot.facts import Facts
    from fleet.robot.release import Release

_PLUGGED = re.compile(r"/dev/(ttyUSB|ttyACM|ttyAMA|ttyTHS|serial|video|v4l/by-id|i2c-|spidev|input/by-id)\S*")

_SHOWN = 8
"""Devices of the robot that a message names."""


def check(robot: Robot, release: Release, facts: Facts) -> None:
    """Refuse a release for which something is missing on the robot.

    Raises:
        NotReady: the first such thing, and its cure.

    """
    for device in robot.hardware.devices:
        _check_device(f"the inventory expects {device}", device, robot, facts)
    for image in release.images:
        _check_image(image, facts)
    for name, service in json.loads(release.compose)["services"].items():
        _check_runtime(name, service, robot, facts)
        for reserved in _reserved(service):
            _check_gpu(name, reserved, robot, facts)
        for device in devices(service):
            _check_device(f"service {name} wants {device}", device, robot, facts)
        _check_ports(name, service, robot, facts)


def _check_image(image: Image, facts: Facts) -> None:
    """CUDA and the drivers of one major version of NVIDIA's Linux do not run on another."""
    wanted, there = image.l4t.partition(".")[0], facts.hardware.l4t_major
    if wanted and there and wanted != there:
        raise NotReady(
            f"the image {image.reference} is made for L4T {image.l4t}, and the robot has L4T {facts.hardware.l4t}",
            cure=f"use an image for L4T {there} (its tag often has `r{there}`), and run `fab build`",
        )


def _check_runtime(name: str, service: Mapping[str, Any], robot: Robot, facts: Facts) -> None:
    runtime, there = service.get("runtime"), facts.docker.runtimes
    # containerd finds such a one by its name, without Docker's settings.
    if runtime and there and runtime not in there and not runtime.startswith("io.containerd."):
        known = ", ".join(one for one in there if not one.startswith("io.containerd."))
        raise NotReady(
            f"service {name} wants the runtime {runtime}, and the robot's Docker has {known}",
            cure=_nvidia_cure(robot, facts) if runtime == "nvidia" else f"remove `runtime:` of {name}",
        )


def _check_gpu(name: str, reserved: Mapping[str, Any], robot: Robot, facts: Facts) -> None:
    """``reserved`` is one of the devices that a service reserves; a release has `gpus:` and CDI devices there, too."""
    driver = reserved.get("driver") or ""
    if driver == "cdi":
        for device in reserved.get("device_ids") or ():
            _check_cdi(name, device, robot, facts)
        return
    if driver not in ("", "nvidia") or "gpu" not in (reserved.get("capabilities") or ()):
        return
    by_cdi = facts.docker.cdi and any(device.startswith("nvidia.com/") for device in facts.hardware.cdi)
    if facts.docker.runtimes and "nvidia" not in facts.docker.runtimes and not by_cdi:
        raise NotReady(
            f"service {name} wants a GPU, and the robot's Docker has no runtime nvidia",
            cure=_nvidia_cure(robot, facts),
        )


def _check_cdi(name: str, device: str, robot: Robot, facts: Facts) -> None:
    there = facts.hardware.cdi
    if device not in there:
        known = f"it has {', '.join(there[:_SHOWN])}" if there else "it has no CDI specification in /etc/cdi"
        generate = "`sudo nvidia-ctk cdi generate --output=/etc/cdi/nvidia.yaml` on the robot"
        raise NotReady(
            f"service {name} wants the CDI device {device}, and the robot does not have it: {known}",
            cure=(generate if facts.hardware.toolkit else _nvidia_cure(robot, facts))
            if device.startswith("nvidia.com/")
            else f"correct `devices:` of {name}",
        )
    if not facts.docker.cdi:
        raise NotReady(
            f"service {name} wants the CDI device {device}, and CDI is off in the robot's Docker {facts.docker.version}",
            cure='write `"features": {"cdi": true}` into /etc/docker/daemon.json on the robot (Docker 25 or newer), and '
            "restart Docker: `sudo systemctl restart docker`",
        )


def _nvidia_cure(robot: Robot, facts: Facts) -> str:
    provision = f"`fab provision --hosts {robot.name}` tells Docker of the runtime"
    if facts.hardware.toolkit:
        return provision
    if facts.hardware.l4t:
        return f"`sudo apt-get install nvidia-container-toolkit` on the robot; then {provision}"
    return "use a robot with an NVIDIA GPU and the NVIDIA Container Toolkit, or another Compose file for this one"


def _check_device(what: str, device: str, robot: Robot, facts: Facts) -> None:
    there = facts.hardware.devices
    if not there or device in there or not device.startswith("/dev/"):
        return
    plugged = [path for path in there if _PLUGGED.fullmatch(path)]
    seen = f"it has {', '.join(plugged[:_SHOWN])}" if plugged else "nothing of that kind is plugged in"
    raise NotReady(f"{what}, which the robot does not have: {seen}", cure=_device_cure(device, robot, facts))


def _device_cure(device: str, robot: Robot, facts: Facts) -> str:
    provision, hardware = f"`fab provision --hosts {robot.name}`", robot.hardware
    if (name := device.removeprefix("/dev/")) in hardware.udev:
        if f'SYMLINK+="{name}"' not in facts.hardware.udev_rules:
            return f"{provision} gives it that name"
        return f"plug it in; `udev:` of {robot.name} says how it is recognised, and `lsusb` on the robot what is there"
    for interface, path in (("i2c", "/dev/i2c-"), ("spi", "/dev/spidev"), ("serial", "/dev/serial")):
        if device.startswith(path) and facts.hardware.boot_folder and not device.startswith("/dev/serial/"):
            if interface in facts.hardware.reboot_for:
                return f"reboot it to switch on {interface}: `fab run --hosts {robot.name} -- sudo reboot`"
            if interface not in facts.hardware.interfaces:
                write = f"write `hardware: {{interfaces: [{interface}]}}` for {robot.name} in the inventory"
                return (
                    f"{provision}, then reboot it"
                    if interface in hardware.interfaces
                    else f"{write}; {provision}"
                )
    return f"plug it in; or correct the path in `devices:` (`fab inventory --facts --hosts {robot.name}` lists devices)"


def _check_ports(name: str, service: Mapping[str, Any], robot: Robot, facts: Facts) -> None:
    """Docker 28 publishes no ports on a kernel without the iptables table ``raw`` (moby #49557)."""
    major = facts.docker.version.partition(".")[0]
    if facts.hardware.raw_table is not False or not major.isdecimal() or int(major) < 28:
        return
    mode = str(service.get("network_mode") or "")
    if service.get("ports") and not mode.startswith(("host", "none", "service:", "container:")):
        raise NotReady(
            f"service {name} publishes ports, and Docker {facts.docker.version} cannot do that here: the robot's kernel has "
            "no iptables table `raw`",
            cure=f"write `network_mode: host` in place of `ports:`; or write `docker: {{version: 27.5.1}}` for {robot.name} "
            f"in the inventory, remove Docker on the robot, and `fab provision --hosts {robot.name}`",
        )


def _reserved(service: Mapping[str, Any]) -> Iterable[Mapping[str, Any]]:
    resources = (service.get("deploy") or {}).get("resources") or {}
    return (resources.get("reservations") or {}).get("devices") or ()


def devices(service: Mapping[str, Any]) -> Iterable[str]:
    """The paths of the robot's devices that a service of a release has."""
    for one in service.get("devices") or ():
        yield one["source"] if isinstance(one, dict) else one.partition(":")[0]
