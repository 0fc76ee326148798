from __future__ import annotations

import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.ros import cdr

if TYPE_CHECKING:
    from pathlib import Path

FILES = {
    "std_msgs/msg/Header.msg": "# A header.\nbuiltin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/msg/Time.msg": "int32 sec\nuint32 nanosec\n",
    "pkg/msg/Scan.msg": "std_msgs/Header header # when\nPoint[] points\nPoint[<=3] few\nint32 A=1\n\r\nstring<=5 name 'x'\n",
    "pkg/msg/Point.msg": "float64 x",  # without an end of the line
    "pkg/msg/Broken.msg": "other/Lost lost\n",
}


def run(home: Path, kind: str, *, prefix: str = "", find: str = "") -> subprocess.CompletedProcess[str]:
    """The script with one prefix of packages; with ``find``, that is the script that searches."""
    if find and (home.parent / "bin/sh").resolve().name == "busybox":
        pytest.skip("busybox runs its own find, which would search all of this computer")
    tool = home.parent / "bin/find"
    tool.write_text(f"#!/bin/sh\n{find}\n")
    tool.chmod(0o755)
    share = home / "install/share"
    for name, text in FILES.items():
        (share / name).parent.mkdir(parents=True, exist_ok=True)
        (share / name).write_text(text)
    environment = {"PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}"}
    if prefix:
        environment["AMENT_PREFIX_PATH"] = prefix
    argv = ("sh", "-c", onboard.text("ros2_types.sh"), "types", kind)
    return subprocess.run(argv, env=environment, capture_output=True, text=True, check=False, timeout=60)


def test_a_type_and_all_that_it_uses(home: Path) -> None:
    """Each once, from the packages of the programs that run, and the listener can parse it."""
    done = run(home, "pkg/Scan", prefix=f"/nowhere:{home / 'install'}")
    assert done.returncode == 0
    types = cdr.parse("pkg/Scan", done.stdout)
    assert list(types) == ["pkg/Scan", "std_msgs/Header", "pkg/Point", "builtin_interfaces/Time"]
    assert done.stdout.count("=== pkg/Point\n") == 1
    assert [field.name for field in types["pkg/Scan"]] == ["header", "points", "few", "name"]


def test_an_installation_elsewhere_is_searched_for(home: Path) -> None:
    """Once: the folder that was found counts for all other packages."""
    found = f'echo "$*" >> {home}/searched; echo {home}/install/share/pkg/msg/Scan.msg'
    done = run(home, "pkg/Scan", find=found)
    assert (done.returncode, done.stdout.count("===")) == (0, 4)
    assert (home / "searched").read_text().splitlines() == ["/ -xdev -path */share/pkg/msg/Scan.msg"]


def test_a_type_that_is_not_there(home: Path) -> None:
    """Nor one that uses a type that is not there."""
    for kind in ("pkg/None", "pkg/Broken"):
        assert run(home, kind, prefix=str(home / "install"), find="exit 0").returncode == 1
