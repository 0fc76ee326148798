from __future__ import annotations

import os
import subprocess
from typing import TYPE_CHECKING

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path


def ran(tmp_path: Path, rules: str, *, udev: bool = True) -> str:
    """The script with a udevadm that notes what it is asked, or with none."""
    programs = tmp_path / "bin"
    programs.mkdir(exist_ok=True)
    for name in ("cat", "dirname", "mkdir", "mv", "rm", "sync"):
        (programs / name).unlink(missing_ok=True)
        (programs / name).symlink_to(f"/bin/{name}" if os.path.exists(f"/bin/{name}") else f"/usr/bin/{name}")  # noqa: PTH110
    (programs / "udevadm").unlink(missing_ok=True)
    if udev:
        (programs / "udevadm").write_text(f'#!/bin/sh\necho "$*" >> {tmp_path}/asked\n')
        (programs / "udevadm").chmod(0o755)
    return subprocess.run(
        (
            "/bin/sh",
            "-c",
            onboard.text("udev_rules.sh"),
            "udev_rules",
            str(tmp_path / "rules.d" / "99-fleet.rules"),
        ),
        input=rules,
        env={"PATH": str(programs)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def test_rules_are_written_and_used(tmp_path: Path) -> None:
    """What is plugged in gets its name at once, without plugging it in again."""
    assert ran(tmp_path, "a rule\n") == ""
    assert [path.name for path in (tmp_path / "rules.d").iterdir()] == ["99-fleet.rules"]
    assert (tmp_path / "rules.d" / "99-fleet.rules").read_text() == "a rule\n"
    asked = (tmp_path / "asked").read_text().splitlines()
    assert [line.split()[0] for line in asked] == ["control", "trigger", "settle"]


def test_no_rules_no_file(tmp_path: Path) -> None:
    """Names that the inventory does not have any more."""
    ran(tmp_path, "a rule\n")
    ran(tmp_path, "")
    assert list((tmp_path / "rules.d").iterdir()) == []


def test_a_robot_without_udev_is_told(tmp_path: Path) -> None:
    """A container, or a very small system: the file is there when udev comes."""
    assert ran(tmp_path, "a rule\n", udev=False).startswith("note: there is no udev on this robot")
