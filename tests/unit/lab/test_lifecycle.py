from pathlib import Path

import pytest

from fleet.config import inventory
from fleet.errors import DesktopError, UsageError
from fleet.lab import lifecycle
from fleet.lab.virtual_pi import VirtualPi

PIS = tuple(
    VirtualPi(
        name=f"pi{number}", lab="lab", address=f"172.30.0.1{number}", platform="linux/arm64", state="running"
    )
    for number in (1, 2)
)


def nothing(_said: str) -> None:
    """Listen to what a lab says, and forget it."""


@pytest.mark.parametrize("count", [0, -1, 201])
def test_a_count_that_cannot_be_is_refused(tmp_path: Path, count: int) -> None:
    """Before anything is made."""
    with pytest.raises(UsageError, match=rf"cannot have {count} Pis; choose --count from 1 to 200"):
        lifecycle.up(count, directory=tmp_path / "lab", say=nothing)
    assert not (tmp_path / "lab").exists()


@pytest.mark.parametrize("name", ["", "Lab", "a b", "-x", "x/y", "$(id)"])
def test_a_name_docker_would_refuse_is_refused_first(tmp_path: Path, name: str) -> None:
    """The name becomes part of container, volume and network names."""
    with pytest.raises(UsageError, match="a lab cannot be called"):
        lifecycle.up(1, directory=tmp_path / "lab", name=name, say=nothing)


@pytest.mark.parametrize("endpoint", ["ssh://someone@example.org", "tcp://192.0.2.1:2376"])
def test_another_computers_engine_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, endpoint: str
) -> None:
    """Its containers have addresses this computer cannot reach; nothing is asked over the network to know that."""
    monkeypatch.setenv("DOCKER_HOST", endpoint)
    with pytest.raises(DesktopError, match=r"cannot reach virtual Pis by address.*another computer's"):
        lifecycle.up(1, directory=tmp_path / "lab", say=nothing)
    assert not (tmp_path / "lab").exists()


def test_the_written_inventory_is_one_the_project_reads(tmp_path: Path) -> None:
    """Paths are found from the inventory's own folder, wherever `fab` is called."""
    recipe = tmp_path / "docker" / 'a "quoted" place'
    recipe.mkdir(parents=True)
    (recipe / "get-docker.sh").write_text("true\n")
    folder = tmp_path / "clone" / ".lab"
    folder.mkdir(parents=True)
    lifecycle.write_inventory(PIS, directory=folder, platform="linux/arm64", recipe=recipe)
    robots = inventory.load(folder / "inventory.yaml").select("all")
    assert [(robot.name, robot.address, robot.user, robot.platform) for robot in robots] == [
        ("pi1", "172.30.0.11", "pi", "linux/arm64"),
        ("pi2", "172.30.0.12", "pi", "linux/arm64"),
    ]
    assert {Path(robot.docker.script).resolve() for robot in robots} == {recipe / "get-docker.sh"}
    assert {robot.identity_file for robot in robots} == {folder / "id_ed25519"}
    assert {robot.known_hosts for robot in robots} == {folder / "known_hosts"}


def test_the_recipe_of_virtual_pis_is_there() -> None:
    """In the package itself, so that it travels in the wheel."""
    assert (lifecycle.RECIPE / "Dockerfile").is_file()
