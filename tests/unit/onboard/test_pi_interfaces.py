from __future__ import annotations

import os
import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.robot import raspberry_pi
from tests.support.robot_shell import EACH_SHELL

if TYPE_CHECKING:
    from pathlib import Path

FOUND = b"# Gr\xfc\xdfe of a person\r\n#dtparam=i2c_arm=on\ndtparam=audio=on\n[pi5]\ndtoverlay=x"
CMDLINE = b"console=serial0,115200 console=tty1 root=PARTUUID=1 rootwait\n"
FIRST, LAST = b'# fleet: what "interfaces:" of the inventory says\n', b"# fleet: end\n"
LINES = raspberry_pi.lines("Raspberry Pi 4")
RASPI_CONFIG = """#!/bin/sh
echo "$*" >> "$(dirname "$0")/asked"
case $2 in do_spi) echo dtparam=spi=on >> {config} ;; do_serial*) ;; *) exit 127 ;; esac
"""


@pytest.fixture
def boot(tmp_path: Path) -> Path:
    """The boot partition of a Pi, and the few folders of its system that the script writes to."""
    for folder in ("boot", "etc/modules-load.d", "run", "bin"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "boot" / "config.txt").write_bytes(FOUND)
    (tmp_path / "boot" / "cmdline.txt").write_bytes(CMDLINE)
    return tmp_path / "boot"


def switch_on(boot: Path, *names: str, shell: str = "sh") -> subprocess.CompletedProcess[str]:
    root = boot.parent
    script = onboard.text("pi_interfaces.sh")
    for folder in ("/etc/modules-load.d", "/run/fleet"):
        assert folder in script
        script = script.replace(folder, f"{root}{folder}")
    return subprocess.run(
        (
            *((shell, "sh") if shell == "busybox" else (shell,)),
            *("-c", script, "pi_interfaces", str(boot), *(f"{name}={LINES[name]}" for name in names)),
        ),
        env={"PATH": f"{root}/bin:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_without_raspi_config(boot: Path, shell: str) -> None:
    """Marked lines at the end, for all boards; every other byte stays, and so does a copy."""
    done = switch_on(boot, "i2c", "serial", "camera", shell=shell)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "note: reboot the robot to switch on: i2c serial camera\n"
    lines = b"[all]\ndtparam=i2c_arm=on\nenable_uart=1\ncamera_auto_detect=1\n"
    assert (boot / "config.txt").read_bytes() == FOUND + b"\n" + FIRST + lines + LAST
    assert (boot / "cmdline.txt").read_bytes() == b"console=tty1 root=PARTUUID=1 rootwait\n"
    assert (boot / "config.txt.before-fleet").read_bytes() == FOUND
    assert (boot / "cmdline.txt.before-fleet").read_bytes() == CMDLINE
    assert not list(boot.glob("*.new"))
    assert (boot.parent / "etc/modules-load.d/fleet-i2c.conf").read_text() == "i2c-dev\n"
    assert (boot.parent / "run/fleet-reboot").read_text().split() == ["i2c", "serial", "camera"]
    config, cmdline = (boot / "config.txt").read_text("latin-1"), (boot / "cmdline.txt").read_text()
    assert raspberry_pi.switched_on(config, cmdline=cmdline, model="Raspberry Pi 4") == (
        "i2c",
        "serial",
        "camera",
    )


def test_the_folder_of_ubuntu(boot: Path) -> None:
    """Since 25.10 the kernel reads its parameters there."""
    (boot / "current").mkdir()
    (boot / "cmdline.txt").rename(boot / "current/cmdline.txt")
    assert switch_on(boot, "serial").returncode == 0
    assert (boot / "current/cmdline.txt").read_bytes() == b"console=tty1 root=PARTUUID=1 rootwait\n"
    assert (boot / "current/cmdline.txt.before-fleet").read_bytes() == CMDLINE


def test_more_interfaces_later(boot: Path) -> None:
    """They join the marked lines; the copy is still that of the first time."""
    switch_on(boot, "i2c")
    switch_on(boot, "spi")
    lines = b"[all]\ndtparam=i2c_arm=on\ndtparam=spi=on\n"
    assert (boot / "config.txt").read_bytes() == FOUND + b"\n" + FIRST + lines + LAST
    assert (boot / "config.txt.before-fleet").read_bytes() == FOUND


def test_with_raspi_config(boot: Path) -> None:
    """It is asked first; what it does not know gets a line of fleet's."""
    tool = boot.parent / "bin" / "raspi-config"
    tool.write_text(RASPI_CONFIG.format(config=boot / "config.txt"))
    tool.chmod(0o755)
    assert switch_on(boot, "i2c", "spi", "serial", "camera").returncode == 0
    asked = (tool.parent / "asked").read_text().splitlines()
    assert asked == [
        f"nonint {words}" for words in ("do_i2c 0", "do_spi 0", "do_serial_hw 0", "do_serial_cons 1")
    ]
    own = FIRST + b"[all]\ndtparam=i2c_arm=on\ncamera_auto_detect=1\n" + LAST
    assert (boot / "config.txt").read_bytes().endswith(own)
    assert (boot / "config.txt.before-fleet").read_bytes() == FOUND


def test_half_of_the_marks_is_refused(boot: Path) -> None:
    """Without the second mark, all that follows the first one would be taken for fleet's."""
    broken = FOUND + b"\n" + FIRST + b"dtparam=spi=on\ngpu_mem=128\n"
    (boot / "config.txt").write_bytes(broken)
    done = switch_on(boot, "i2c")
    assert done.returncode == 1
    assert "has one of the lines" in done.stderr
    assert (boot / "config.txt").read_bytes() == broken
    assert not (boot.parent / "run/fleet-reboot").exists()


def test_a_full_disk_leaves_the_old_file(boot: Path) -> None:
    """A Pi with half a cmdline.txt does not boot."""
    sed = boot.parent / "bin" / "sed"
    sed.write_text("#!/bin/sh\nprintf half\nexit 4\n")
    sed.chmod(0o755)
    assert switch_on(boot, "serial").returncode == 4
    assert (boot / "cmdline.txt").read_bytes() == CMDLINE
    assert (boot / "config.txt").read_bytes() == FOUND


def test_what_waits_for_a_reboot_is_noted_before_it_is_switched_on(boot: Path) -> None:
    """If it is interrupted in between, nobody would know why the device is missing."""
    tool = boot.parent / "bin" / "raspi-config"
    tool.write_text(f"#!/bin/sh\ncp {boot.parent}/run/fleet-reboot {boot.parent}/noted\nkill -KILL $PPID\n")
    tool.chmod(0o755)
    assert switch_on(boot, "i2c", "spi").returncode < 0
    assert (boot.parent / "noted").read_text().split() == ["i2c", "spi"]


def test_copies_are_on_the_card_before_the_originals_change(boot: Path) -> None:
    """Each rename comes between two syncs."""
    programs = boot.parent / "bin"
    for name in ("sync", "mv"):
        log = f'for one; do printf " %s" "${{one##*/}}" >>{boot.parent}/log; done; echo >>{boot.parent}/log'
        text = f'#!/bin/sh\nprintf {name} >>{boot.parent}/log\n{log}\nexec {shutil.which(name)} "$@"\n'
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    switch_on(boot, "spi")
    kept = [
        [f"sync {name}.before-fleet.new", f"mv {name}.before-fleet.new {name}.before-fleet", "sync boot"]
        for name in ("config.txt", "cmdline.txt")
    ]
    own = ["sync config.txt.new", "mv config.txt.new config.txt", "sync boot", "sync"]
    assert (boot.parent / "log").read_text().splitlines() == [*kept[0], *kept[1], *own]
