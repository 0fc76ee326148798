from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.cli.selection import select
from fleet.errors import InventoryError

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.project import Project


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "inventory.yaml"),
        ("robots: [\n", "inventory.yaml"),
        ("robots:\n  pi1:\n    adress: x\n", "3: robots.pi1.adress: no such key; did you mean 'address'?"),
        ("robots:\n  pi1: {port: 0}\nstak: x\n", "2 problems"),
        ("stack: none.yaml\nrobots: {pi1: pi1.local}\n", "none.yaml"),
        ("robots: {}\n", "names no robots"),
    ],
)
def test_a_bad_inventory_is_refused(own: Project, text: str, what: str) -> None:
    """With file, line, key and cure; before anybody is called."""
    (own.folder / "inventory.yaml").write_text(text)
    done = own.fleet("ship")
    assert (done.code, done.out) == (2, "")
    assert what in done.err
    assert "Traceback" not in done.err


def test_the_inventory_of_the_environment(mine: Project, tmp_path: Path) -> None:
    """$FLEET_INVENTORY names one, --inventory another that comes first."""
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(f"robots: {{{name}: {name}.local}}\n")
    one, two = str(tmp_path / "one.yaml"), str(tmp_path / "two.yaml")
    assert mine.fab("inventory", FLEET_INVENTORY=one).out.startswith("one\n")
    assert mine.fab("inventory", "--inventory", two, FLEET_INVENTORY=one).out.startswith("two\n")


def test_robots_are_selected_by_name_group_wildcard_and_list(mine: Project) -> None:
    """In the order of the inventory, each once."""
    for hosts, names in (
        ("pi2", ["pi2"]),
        ("fleet", ["pi1", "pi2"]),
        ("pi?,pi1", ["pi1", "pi2"]),
        ("away,pi1", ["pi1", "away"]),
        ("all", ["pi1", "pi2", "away"]),
    ):
        said = json.loads(mine.fleet("inventory", "--json", "--hosts", hosts).out)
        assert [robot["name"] for robot in said] == names


def test_the_nearest_inventory_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Upwards from where the person is; none at all is refused."""
    (tmp_path / "deep/er").mkdir(parents=True)
    (tmp_path / "inventory.yaml").write_text("robots: {outer: outer.local}\n")
    monkeypatch.delenv("FLEET_INVENTORY", raising=False)
    monkeypatch.chdir(tmp_path / "deep/er")
    assert [robot.name for robot in select("", "all")[1]] == ["outer"]
    (tmp_path / "deep/inventory.yaml").write_text("robots: {inner: inner.local}\n")
    assert [robot.name for robot in select("", "all")[1]] == ["inner"]
    monkeypatch.chdir("/")
    with pytest.raises(InventoryError, match=r"inventory\.yaml"):
        select("", "all")
