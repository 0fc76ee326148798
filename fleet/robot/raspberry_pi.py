"""Which interfaces of a Raspberry Pi are switched on? Read from the files that its firmware reads at boot."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

CONSOLE = r"console=(serial0|ttyAMA0|ttyS0)"
"""The kernel's console on the serial port, in cmdline.txt: with it, the port is no program's."""

_FIVE = re.compile(r"Raspberry Pi (5|Compute Module 5)")
_PARAMETER = r"^(device_tree_param|dtparam)=([^,]*,)*{}(=(on|true|yes|1))?(,.*)?$"


def patterns(model: str) -> Mapping[str, str]:
    """The line of config.txt that switches each interface on, as an extended regular expression (those of raspi-config)."""
    return {
        "i2c": _PARAMETER.format("i2c(_arm)?"),
        "spi": _PARAMETER.format("spi"),
        "serial": _PARAMETER.format("uart0") if _FIVE.match(model) else "^enable_uart=1$",
        "camera": "^(camera_auto_detect|start_x)=1$",
    }


def lines(model: str) -> Mapping[str, str]:
    """The line for config.txt that switches each interface on."""
    # https://www.raspberrypi.com/documentation/computers/config_txt.html
    return {
        "i2c": "dtparam=i2c_arm=on",
        "spi": "dtparam=spi=on",
        "serial": "dtparam=uart0=on" if _FIVE.match(model) else "enable_uart=1",
        "camera": "camera_auto_detect=1",
    }


def switched_on(config: str, *, cmdline: str, model: str) -> tuple[str, ...]:
    """The interfaces that ``config``, the text of config.txt, switches on. A serial port with a console on it is not."""
    on = [name for name, line in patterns(model).items() if re.search(line, config, re.MULTILINE)]
    return tuple(name for name in on if name != "serial" or not re.search(CONSOLE, cmdline))
