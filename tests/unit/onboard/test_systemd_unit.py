from __future__ import annotations

import hashlib
import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path

UNIT = b"[Service]\nExecStart=/bin/true\n"


def ran(tmp_path: Path, arrived: bytes, *words: str) -> subprocess.CompletedProcess[bytes]:
    """The script with a systemctl that notes what it is asked."""
    script = onboard.text("systemd_unit.sh")
    assert "/etc/systemd/system" in script
    programs = tmp_path / "bin"
    programs.mkdir(exist_ok=True)
    (programs / "systemctl").write_text(f'#!/bin/sh\necho "$*" >>{tmp_path}/asked\n')
    (programs / "systemctl").chmod(0o755)
    how = ("fleet-boot", hashlib.sha256(UNIT).hexdigest(), onboard.text("replace_file.sh"), *words)
    return subprocess.run(
        ("sh", "-c", script.replace("/etc/systemd/system", f"{tmp_path}/units"), "systemd_unit", *how),
        input=arrived,
        env={"PATH": f"{programs}:{os.environ['PATH']}"},
        capture_output=True,
        check=False,
    )


def test_a_unit_is_written_and_enabled(tmp_path: Path) -> None:
    """And started anew, if that is asked for."""
    assert ran(tmp_path, UNIT).returncode == 0
    assert (tmp_path / "units/fleet-boot.service").read_bytes() == UNIT
    asked = ["daemon-reload", "enable --quiet fleet-boot"]
    assert (tmp_path / "asked").read_text().splitlines() == asked
    assert ran(tmp_path, UNIT, "restart").returncode == 0
    assert (tmp_path / "asked").read_text().splitlines() == [*asked, *asked, "restart fleet-boot"]
    assert [path.name for path in (tmp_path / "units").iterdir()] == ["fleet-boot.service"]


@pytest.mark.parametrize("arrived", [b"", UNIT[:-3]])
def test_a_unit_that_was_cut_is_not_used(tmp_path: Path, arrived: bytes) -> None:
    """An empty unit that is enabled would be taken for the right one at the next boot."""
    assert ran(tmp_path, arrived).returncode == 74
    assert list((tmp_path / "units").iterdir()) == []
    assert not (tmp_path / "asked").exists()
