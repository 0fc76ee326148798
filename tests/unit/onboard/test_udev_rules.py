from __future__ import annotations

import hashlib
import shutil
import socket
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path


def ran(
    tmp_path: Path, rules: str, *, arrived: str | None = None, udev: str = "exit 0", runs: bool = True
) -> subprocess.CompletedProcess[str]:
    """The script with a udevadm that notes what it is asked, or with none. ``arrived`` of the rules comes through."""
    programs = tmp_path / "bin"
    programs.mkdir(exist_ok=True)
    for name in ("cat", "cp", "cut", "dirname", "mkdir", "mv", "rm", "sh", "sha256sum", "sync"):
        (programs / name).unlink(missing_ok=True)
        (programs / name).symlink_to(shutil.which(name) or "")
    (programs / "udevadm").unlink(missing_ok=True)
    if udev:
        (programs / "udevadm").write_text(f'#!/bin/sh\necho "$*" >> {tmp_path}/asked\n{udev}\n')
        (programs / "udevadm").chmod(0o755)
    digest = (hashlib.sha256(rules.encode()).hexdigest(), onboard.text("replace_file.sh")) if rules else ()
    path, control = str(tmp_path / "rules.d" / "99-fleet.rules"), str(tmp_path / "control")
    script = onboard.text("udev_rules.sh")
    assert "/run/udev/control" in script
    with socket.socket(socket.AF_UNIX) as listens:
        if runs:
            listens.bind(control)
        done = subprocess.run(
            ("/bin/sh", "-c", script.replace("/run/udev/control", control), "udev_rules", path, *digest),
            input=rules if arrived is None else arrived,
            env={"PATH": str(programs)},
            capture_output=True,
            text=True,
            check=False,
        )
    (tmp_path / "control").unlink(missing_ok=True)
    return done


def there(tmp_path: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in (tmp_path / "rules.d").iterdir()}


def test_rules_are_written_and_used(tmp_path: Path) -> None:
    """What is plugged in gets its name at once, without plugging it in again."""
    done = ran(tmp_path, "a rule\n")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert there(tmp_path) == {"99-fleet.rules": "a rule\n"}
    asked = (tmp_path / "asked").read_text().splitlines()
    assert [line.split()[0] for line in asked] == ["control", "trigger", "settle"]


def test_no_rules_no_file(tmp_path: Path) -> None:
    """Names that the inventory does not have any more."""
    ran(tmp_path, "a rule\n")
    assert ran(tmp_path, "").returncode == 0
    assert there(tmp_path) == {}


@pytest.mark.parametrize("arrived", ["", "a ru"])
def test_rules_that_were_cut_are_not_used(tmp_path: Path, arrived: str) -> None:
    """Least of all does an input that ended early remove the names."""
    ran(tmp_path, "a rule\n")
    assert ran(tmp_path, "another rule\n", arrived=arrived).returncode == 74
    assert there(tmp_path) == {"99-fleet.rules": "a rule\n"}


@pytest.mark.parametrize("failing", ["control", "trigger"])
def test_rules_that_udev_does_not_take_are_taken_back(tmp_path: Path, failing: str) -> None:
    """Otherwise the next `fab provision` would find the file, and do nothing."""
    fails = f"[ $1 != {failing} ] || {{ echo 'Failed to send reload request' >&2; exit 1; }}"
    done = ran(tmp_path, "a rule\n", udev=fails)
    assert done.returncode == 1
    assert done.stderr == "udev did not take the rules: Failed to send reload request\n"
    assert there(tmp_path) == {}
    ran(tmp_path, "a rule\n")
    for rules in ("another rule\n", ""):
        assert ran(tmp_path, rules, udev=fails).returncode == 1
        assert there(tmp_path) == {"99-fleet.rules": "a rule\n"}


def test_a_robot_without_udev_is_told(tmp_path: Path) -> None:
    """A container, or a very small system: the file is there when udev starts, and reads it then."""
    for udev, runs in (("", True), ("exit 1", False)):
        done = ran(tmp_path, "a rule\n", udev=udev, runs=runs)
        assert (done.returncode, done.stdout[:40]) == (0, "note: udev does not run on this robot: t")
        assert there(tmp_path) == {"99-fleet.rules": "a rule\n"}
