from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.cli import whose
from fleet.cli.stacks import RobotStack
from fleet.config.compose import LEVELS, Project
from fleet.config.inventory import StackFiles
from fleet.errors import NotReady, SelectionError, Unreachable
from fleet.robot.facts import StackFacts
from tests.support.samples import PI, STACK, container, facts

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.errors import FleetError
    from fleet.robot.facts import Facts


TWIN = PI.model_copy(update={"name": "pi2"})


def test_one_address_for_two_robots_is_refused() -> None:
    """Before any robot is asked: each would replace what the other runs."""
    assert whose.twins([PI, TWIN]) == [("pi1", "pi2")]
    with pytest.raises(SelectionError, match=r"pi1 and pi2 have the same address, pi1\.local"):
        whose.once([PI, TWIN])


def test_a_twin_that_was_not_chosen_counts_too() -> None:
    """`--hosts pi1` would replace what pi2 runs as well; twins that nobody ships to are left alone."""
    with pytest.raises(SelectionError, match="have the same address"):
        whose.once([PI], among=[TWIN, PI])
    third = PI.model_copy(update={"name": "pi3", "address": "pi3.local"})
    whose.once([third], among=[PI, TWIN, third])


def test_one_computer_is_seen_by_its_identity() -> None:
    """Robots that did not answer, or do not tell, are no pair."""
    seen: dict[str, Facts | FleetError] = {
        "a": facts(identity="x"),
        "b": facts(identity="x"),
        "c": facts(),
        "d": facts(),
        "e": Unreachable(""),
    }
    assert whose.same_computers(seen) == [("a", "b")]


def test_robots_behind_one_forwarder_are_different() -> None:
    """They share an address, and each has its own port."""
    whose.once([PI, TWIN.model_copy(update={"port": 2222})])


def test_one_computer_under_two_addresses_is_refused() -> None:
    """The first that comes has it; cards that are copies of each other do not share the boot ID."""
    machines = whose.Machines()
    machines.claim(PI, facts(identity="a b"))
    machines.claim(PI, facts(identity="a b"))
    machines.claim(TWIN, facts(identity="a c"))
    with pytest.raises(NotReady, match="pi3 and pi1 are the same computer"):
        machines.claim(TWIN.model_copy(update={"name": "pi3"}), facts(identity="a b"))


def test_a_robot_of_another_name_is_refused_until_it_is_said_to_be_renamed() -> None:
    """A router may give its address to another robot; what runs there says whose it is."""
    seen = facts(containers=(container("abc", robot="pi9"),))
    with pytest.raises(NotReady) as caught:
        whose.Machines().claim(PI, seen)
    assert caught.value.what == "this computer was shipped to as pi9, and the inventory calls it pi1"
    assert "fab ship --hosts pi1 --renamed" in caught.value.cure
    whose.Machines().claim(PI, seen, renamed=True)
    whose.Machines().claim(PI, facts(containers=(container("abc"),)))


def copied(folder: Path, text: str) -> RobotStack:
    file = folder / "compose.yaml"
    file.write_text(text)
    above = folder.joinpath(*["up"] * LEVELS)
    project = Project(files=(file,), real=folder, folder=above / "copy")
    stack = replace(STACK, name="copy")
    return RobotStack(
        spec=StackFiles(files=(file,)), project=project, stack=stack, environment={}, warnings=()
    )


def test_a_copy_of_a_project_is_not_a_second_stack_by_accident(tmp_path: Path) -> None:
    """It would start beside the first with empty volumes; with a name of its own it may."""
    seen = facts(services=("talker",))
    unnamed = copied(tmp_path, "services: {talker: {image: x}}")
    with pytest.raises(NotReady, match="as stack talker, and this folder's name makes them stack copy"):
        whose.same_stack(unnamed, seen, robot=PI)
    whose.same_stack(unnamed, facts(), robot=PI)
    whose.same_stack(copied(tmp_path, "name: copy\nservices: {talker: {image: x}}"), seen, robot=PI)
    other = replace(seen, fleet=replace(seen.fleet, stacks={"copy": StackFacts(services=("talker",))}))
    whose.same_stack(unnamed, other, robot=PI)
