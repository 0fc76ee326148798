from __future__ import annotations

import importlib.util
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from types import ModuleType

PACKAGE = Path(__file__).parents[3] / "talker"


@pytest.fixture(scope="module")
def clock() -> ModuleType:
    """The talker's words, loaded from the catkin package as they are: no ROS, no installation."""
    spec = importlib.util.spec_from_file_location("clock", PACKAGE / "src/talker/clock.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0, "1970-01-01T00:00:00.000Z"),
        (1795473361.25, "2026-11-23T22:36:01.250Z"),
        (1795473361.9996, "2026-11-23T22:36:01.999Z"),
    ],
)
def test_iso_time(clock: ModuleType, seconds: float, words: str) -> None:
    """Times are UTC, in milliseconds, whatever the robot's time zone is."""
    assert clock.iso_time(seconds) == words


@pytest.mark.parametrize(("value", "rate"), [(1, 1.0), ("2.5", 2.5), (1000, 1000.0)])
def test_messages_per_second(clock: ModuleType, value: object, rate: float) -> None:
    """Numbers are taken as launch files give them."""
    assert clock.messages_per_second(value) == rate


@pytest.mark.parametrize("value", [0, -1, "fast", "", None, float("nan"), float("inf"), 1001])
def test_impossible_rate(clock: ModuleType, value: object) -> None:
    """A rate that cannot be kept is refused by name."""
    with pytest.raises(ValueError, match="rate is "):
        clock.messages_per_second(value)


def test_catkin_lint_finds_nothing() -> None:
    """The package is what catkin expects, down to notices."""
    command = (sys.executable, "-m", "catkin_lint", "-W2", "--strict", "--offline", str(PACKAGE))
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (0, "")
    assert "checked 1 packages and found 0 problems" in done.stderr


def test_launch_arguments_explain_themselves() -> None:
    """`roslaunch --ros-args talker talker.launch` tells what each argument is for."""
    launch = ET.parse(PACKAGE / "launch/talker.launch")  # noqa: S314 - our own file
    arguments = {tag.get("name"): tag.get("doc") for tag in launch.iter("arg")}
    assert set(arguments) == {"topic", "rate"}
    assert all(arguments.values())
