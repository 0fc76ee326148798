from __future__ import annotations

import re
import subprocess

import pytest

from fleet.robot import raspberry_pi

FOUR, FIVE = "Raspberry Pi 4 Model B Rev 1.4", "Raspberry Pi 5 Model B Rev 1.0"
FRESH = """\
# For more options and information see http://rptl.io/configtxt
#dtparam=i2c_arm=on
#dtparam=spi=on
dtparam=audio=on
camera_auto_detect=1
[cm4]
otg_mode=1
[all]
"""
"""Lines of the config.txt of Raspberry Pi OS bookworm."""


@pytest.mark.parametrize(
    ("config", "model", "on"),
    [
        (FRESH, FOUR, ("camera",)),
        (FRESH + "dtparam=i2c_arm=on\ndtparam=spi=on\n", FOUR, ("i2c", "spi", "camera")),
        ("dtparam=i2c=on,spi=on", FOUR, ("i2c", "spi")),
        ("dtparam=audio=on,i2c_arm", FOUR, ("i2c",)),
        ("dtparam=i2c_arm=off\ndtparam=spi=off\nenable_uart=0", FOUR, ()),
        ("enable_uart=1\nstart_x=1", FOUR, ("serial", "camera")),
        ("enable_uart=1", FIVE, ()),
        ("dtparam=uart0=on", FIVE, ("serial",)),
        ("", "", ()),
    ],
)
def test_what_config_txt_switches_on(config: str, model: str, on: tuple[str, ...]) -> None:
    """As raspi-config reads it; on a Pi 5 the serial port has another line."""
    assert raspberry_pi.switched_on(config, cmdline="root=x", model=model) == on


@pytest.mark.parametrize("console", ["serial0,115200", "ttyAMA0,115200", "ttyS0"])
def test_a_port_with_a_console_is_no_programs(console: str) -> None:
    """A sensor on the serial port would talk to a login."""
    said = f"console={console} console=tty1 root=x"
    assert raspberry_pi.switched_on("enable_uart=1", cmdline=said, model=FOUR) == ()


@pytest.mark.parametrize("model", [FOUR, FIVE])
def test_each_line_is_recognised_here_and_by_grep(model: str) -> None:
    """The proof on the robot uses grep with the same expressions."""
    patterns = raspberry_pi.patterns(model)
    for name, line in raspberry_pi.lines(model).items():
        assert re.search(patterns[name], line)
        assert (
            subprocess.run(("grep", "-Eq", patterns[name]), input=line.encode(), check=False).returncode == 0
        )
