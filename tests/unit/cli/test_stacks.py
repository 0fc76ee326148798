from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.cli.stacks import Stacks, environment_of, stacks_there
from fleet.config.inventory import StackFiles
from fleet.config.ros import Ros
from fleet.errors import InventoryError, NotReady, UsageError
from fleet.robot.facts import StackFacts
from tests.support.samples import PI, TALKER, facts

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.config.inventory import Robot

TEXT = """
name: {name}
services:
  node:
    image: talker
    environment: [COLOUR, ROS_HOSTNAME, FLEET_ROBOT]
    volumes: ["./files:/etc/node:ro"]
"""


def robot(folder: Path, *names: str, **values: object) -> Robot:
    """A robot with stacks of these names."""
    specs = []
    for name in names:
        file = folder / name / "compose.yaml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(TEXT.format(name=name))
        specs.append(StackFiles(files=(file,)))
    return PI.model_copy(update={"stacks": tuple(specs), **values})


def test_a_robots_values_reach_its_stack(tmp_path: Path) -> None:
    """The inventory's, its ROS settings and its name; nothing of this computer's shell."""
    with Stacks() as stacks:
        one = robot(tmp_path, "a", environment={"COLOUR": "red"}, ros=Ros(hostname="me"))
        (found,) = stacks.of([one])["pi1"]
        environment = found.stack.model["services"]["node"]["environment"]
        assert environment == {"COLOUR": "red", "ROS_HOSTNAME": "me", "FLEET_ROBOT": "pi1"}


def test_files_of_the_inventory_are_in_the_release(tmp_path: Path) -> None:
    """Below ``files/`` of the project, as its Compose file mounts them; one that is gone is told."""
    here = tmp_path / "camera-2.yaml"
    here.write_text("camera: 2")
    with Stacks() as stacks:
        one = robot(tmp_path, "a", files={"camera.yaml": here})
        (found,) = stacks.of([one])["pi1"]
        release = stacks.release(one, found, images={"node": TALKER})
        assert release.project["files/camera.yaml"].data == b"camera: 2"
        here.unlink()
        other = robot(tmp_path, "a", name="pi2", files={"camera.yaml": here, "b": here})
        with pytest.raises(InventoryError, match="cannot read"):
            stacks.release(other, found, images={"node": TALKER})


def test_one_of_several_stacks_is_chosen_by_its_name(tmp_path: Path) -> None:
    """The name is Compose's; one that does not exist is told with those that do."""
    one = robot(tmp_path, "a", "b")
    with Stacks() as stacks:
        assert [found.stack.name for found in stacks.of([one])["pi1"]] == ["a", "b"]
        assert [found.stack.name for found in stacks.of([one], only="b")["pi1"]] == ["b"]
        with pytest.raises(UsageError, match="pi1 has no stack c; it has: a, b"):
            stacks.of([one], only="c")


def test_two_stacks_of_one_name_are_refused(tmp_path: Path) -> None:
    """On a robot they would be one."""
    twice = robot(tmp_path, "a")
    twice = twice.model_copy(update={"stacks": twice.stacks * 2})
    with Stacks() as stacks, pytest.raises(UsageError, match="pi1 has two stacks with the name a"):
        stacks.of([twice])


def test_variables_of_this_shell_are_passed_on_by_name_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """A token need not be written into the inventory; one that is not set is told."""
    monkeypatch.setenv("TOKEN", "secret")
    assert "TOKEN" not in environment_of(PI)
    passing = PI.model_copy(update={"pass_environment": ("TOKEN",)})
    assert environment_of(passing)["TOKEN"] == "secret"  # noqa: S105  of a test
    monkeypatch.delenv("TOKEN")
    with pytest.raises(UsageError, match="passes TOKEN of your shell on to pi1, and it is not set"):
        environment_of(passing)


def test_which_stacks_a_robot_has() -> None:
    """A verb that needs one of several asks for its name."""
    two = facts()
    stacks = {"a": StackFacts(releases=("1",)), "b": StackFacts(releases=("2",)), "gone": StackFacts()}
    two = replace(two, fleet=replace(two.fleet, stacks=stacks))
    assert stacks_there(two, only="") == ["a", "b"]
    assert stacks_there(two, only="b", alone=True) == ["b"]
    assert stacks_there(facts(), only="") == [""]
    with pytest.raises(NotReady, match="it has several stacks; say which with --stack: a, b"):
        stacks_there(two, only="", alone=True)
    with pytest.raises(NotReady, match="it has no stack c; it has: a, b"):
        stacks_there(two, only="c")
