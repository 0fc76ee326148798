from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.plan import compose_steps
from fleet.robot.history import history
from tests.support.robot_shell import do

if TYPE_CHECKING:
    from pathlib import Path

BY = "tim@desktop"
DOCKER = """#!/bin/sh
case "$*" in
    *"ps "*"project=nav") printf 'one\\ntwo\\n' ;;
    "network ls "*"project=nav") echo net ;;
    "ps "* | "network ls "*) ;;
    *) echo "$*" >>"$HOME/asked" ;;
esac
"""


@pytest.fixture
def stack(home: Path) -> Path:
    """A stack with a release, data and history, beside another one."""
    docker = home.parent / "bin/docker"
    docker.write_text(DOCKER)
    docker.chmod(0o755)
    for name in ("nav", "cam"):
        stack = home / ".fleet/stacks" / name
        (stack / "releases/aaa").mkdir(parents=True)
        (stack / "releases/aaa/compose.yaml").write_text("{}")
        (stack / "data").mkdir()
        (stack / "data/map").write_text("map")
        (stack / "current").symlink_to("releases/aaa")
        (stack / "delivered").write_text("map 1\n")
        (stack / "journal").write_text("ship aaa\n")
        (stack / "history").write_text("one\n")
    return home / ".fleet/stacks/nav"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_containers_networks_and_releases_go_and_data_stays(home: Path, stack: Path) -> None:
    """So do the volumes: what a robot has learned outlives the program."""
    done = do(compose_steps.remove("nav", by=BY), home)
    assert (done.returncode, done.stderr) == (0, b"")
    assert (home / "asked").read_text().splitlines() == [
        "stop one two",  # as long as each needs to write down what it has
        "rm --force one two",
        "network rm net",
    ]
    assert names(stack) == ["data", "delivered", "history"]
    assert (stack / "data/map").read_text() == "map"


def test_another_stack_is_not_touched(home: Path, stack: Path) -> None:
    """Its folder is as before."""
    before = names(stack.parent / "cam")
    do(compose_steps.remove("nav", by=BY), home)
    assert names(stack.parent / "cam") == before


def test_the_history_says_who(home: Path, stack: Path) -> None:
    """And goes on where it was."""
    do(compose_steps.remove("nav", by=BY), home)
    lines = (stack / "history").read_text().splitlines()
    assert lines[0] == "one"
    (event,) = history(tuple(lines[1:]))
    assert (event.verb, event.by, event.outcome) == ("remove", BY, "done")


def test_a_stack_without_containers(home: Path, stack: Path) -> None:
    """Docker is not asked to remove nothing."""
    assert do(compose_steps.remove("cam", by=BY), home).returncode == 0
    assert not (home / "asked").exists()
    assert names(stack.parent / "cam") == ["data", "delivered", "history"]


def test_a_stack_that_is_not_there(home: Path, stack: Path) -> None:
    """Nothing is made, and nothing of Docker's removed."""
    assert do(compose_steps.remove("no", by=BY), home).returncode != 0
    assert not (stack.parent / "no").exists()
    assert not (home / "asked").exists()


def test_a_docker_that_does_not_answer_keeps_the_releases(home: Path, stack: Path) -> None:
    """Its containers may run: their files stay, and the step fails."""
    (home.parent / "bin/docker").write_text("#!/bin/sh\nexit 1\n")
    assert do(compose_steps.remove("nav", by=BY), home).returncode != 0
    assert names(stack / "releases") == ["aaa"]
    assert (stack / "current").is_symlink()
