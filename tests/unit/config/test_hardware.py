from __future__ import annotations

from typing import TYPE_CHECKING

import jsonschema
import pytest

from fleet.config import hardware, yamlfile
from fleet.config.hardware import Hardware, Usb
from fleet.config.inventory import json_schema
from fleet.errors import InventoryError
from tests.support.inventory_files import inventory, problems, write

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """People run `fab` where the inventory is; messages name files from there."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_hardware_adds_up() -> None:
    """A robot of two groups has what both have; names of USB devices are merged by name, the nearest wins."""
    robot = inventory("""
defaults: {hardware: {groups: [dialout]}}
groups:
  lidar: {robots: [pi1], hardware: {devices: [/dev/lidar], udev: {lidar: {vendor: "10c4", product: "ea60"}}}}
  arm: {robots: [pi1], hardware: {devices: [/dev/arm, /dev/lidar], groups: [i2c, dialout], interfaces: [i2c]}}
robots:
  pi1: {hardware: {udev: {lidar: {port: 1-1.2}, cam: {kind: camera, port: 1-1.3}}, interfaces: [spi]}}
  pi2:
""")
    assert robot.robots["pi1"].hardware == Hardware(
        devices=["/dev/lidar", "/dev/arm"],
        udev={"lidar": Usb(port="1-1.2"), "cam": Usb(kind="camera", port="1-1.3")},
        interfaces=["i2c", "spi"],
        groups=["dialout", "i2c"],
    )
    assert robot.robots["pi2"].hardware == Hardware(groups=["dialout"])


KINDS = "kind, vendor, product, serial, port"


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ("[x]", ": must hold `key: value` lines"),
        ("{devces: []}", ".devces: no such key; did you mean 'devices'?"),
        ("{devices: }", ".devices: must be a list"),
        *(
            (
                f"{{devices: ['{path}']}}",
                ".devices[0]: must be the path of a device, such as /dev/ttyUSB0 or /dev/serial/by-id/usb-...",
            )
            for path in ("ttyUSB0", "/dev", "/dev/", "/dev/../etc/passwd", "/dev/a b", "/etc/x", "/dev//x")
        ),
        (
            "{interfaces: [i2x]}",
            ".interfaces[0]: must be one of i2c, spi, serial, camera; did you mean 'i2c'?",
        ),
        ("{groups: [A]}", ".groups[0]: must be the name of a group, such as dialout"),
        (
            "{groups: ['-G']}",
            ".groups[0]: must be the name of a group, such as dialout",
        ),
        ("{udev: {a: {vendr: x}}}", ".udev.a.vendr: no such key; did you mean 'vendor'?"),
        (
            "{udev: {a: {}}}",
            ".udev.a: say which device it is: `vendor` and `product` (`lsusb` shows them), or `port`",
        ),
        (
            "{udev: {a: {vendor: '1234'}}}",
            ".udev.a: vendor and product go together; `lsusb` shows both, as vendor:product",
        ),
        (
            "{udev: {a: {vendor: 0403, product: '6001'}}}",
            ".udev.a.vendor: must be text, not 259; put it in quotes",
        ),
        (
            "{udev: {a: {vendor: '403', product: '6001'}}}",
            ".udev.a.vendor: must be 4 hexadecimal digits in quotes, such as '10c4'; `lsusb` shows them",
        ),
        (
            '{udev: {a: {port: "1-1", serial: "a\\"b"}}}',
            ".udev.a.serial: must be a serial number as `udevadm info -a` shows it, without quotes and wildcards",
        ),
        (
            "{udev: {a: {port: usb1}}}",
            ".udev.a.port: must be a USB port such as '1-1.2', as `udevadm info -a` shows it in KERNELS",
        ),
        ("{udev: {a: {kind: lidar, port: 1-1}}}", ".udev.a.kind: must be one of serial, camera, input"),
        *(
            (
                f"{{udev: {{'{name}': {{port: 1-1}}}}}}",
                (
                    f".udev{shown}: must be a name of your own for /dev, such as 'lidar': letters, digits, '_', '.' and '-'; "
                    "not one of the kernel's, such as ttyUSB0 or video0"
                ),
            )
            for name, shown in (("ttyUSB0", ".ttyUSB0"), ("null", ".null"), ("../x", "['../x']"))
        ),
    ],
)
def test_mistakes_are_told_with_their_place(said: str, sentence: str) -> None:
    """One sentence each, with the line; what would reach a rule of udev or a shell cannot be written."""
    source = f"robots:\n  pi1:\n    hardware: {said}\n"
    assert problems(source) == [f"inventory.yaml:3: robots.pi1.hardware{sentence}"]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(yamlfile.read(write(source), error=InventoryError).value, json_schema())


def test_the_model_at_a_place() -> None:
    """For the keys that a message names."""
    assert hardware.model_at(()) is Hardware
    assert hardware.model_at(("udev",)) is Hardware
    assert hardware.model_at(("udev", "lidar")) is Usb
