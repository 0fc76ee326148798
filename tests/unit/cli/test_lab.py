from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.cli.lab import DIRECTORY
from fleet.lab import lifecycle
from fleet.lab.virtual_pi import VirtualPi

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.project import Project

PI = VirtualPi(name="pi1", lab="lab", address="172.18.0.11", platform="linux/arm64", state="running")


@pytest.mark.parametrize(
    ("words", "err"),
    [
        (("lab.down", "--dry"), "this verb does not support --dry, so nothing was done"),
        (("--dry", "lab.up"), "this verb does not support --dry, so nothing was done"),
        (("lab.up", "--count", "many"), "--count takes a whole number, not many"),
    ],
)
def test_a_lab_is_refused_before_anything_is_done(
    mine: Project, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], err: str
) -> None:
    """Neither made nor removed."""
    for name in ("up", "down"):
        monkeypatch.setattr(lifecycle, name, lambda *_, **__: pytest.fail("the lab was touched"))
    done = mine.fleet(*words)
    assert (done.code, done.err) == (2, f"{err}\n")


def test_a_lab_goes_up_and_down_in_its_folder(mine: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of Pis reaches the lab, and what it reports reaches standard error."""
    calls: list[tuple[object, ...]] = []

    def up(count: int, *, directory: Path, say: Callable[[str], None]) -> None:
        calls.append((count, directory))
        say("2 virtual Pis up")

    def down(*, directory: Path, say: Callable[[str], None]) -> None:
        calls.append((directory,))
        say("removed 2 virtual Pis")

    monkeypatch.setattr(lifecycle, "up", up)
    monkeypatch.setattr(lifecycle, "down", down)
    assert mine.fleet("lab.up", "--count", "2").err == "2 virtual Pis up\n"
    assert mine.fleet("lab.down").err == "removed 2 virtual Pis\n"
    assert calls == [(2, DIRECTORY), (DIRECTORY,)]


def test_the_pis_of_a_lab_are_listed(mine: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a table, and as JSON."""
    monkeypatch.setattr(lifecycle, "list_", lambda: (PI,))
    rows = [line.split() for line in mine.fleet("lab.list").out.splitlines()]
    assert rows == [
        ["name", "address", "state", "platform", "container"],
        ["pi1", "172.18.0.11", "running", "linux/arm64", "lab-pi1"],
    ]
    assert json.loads(mine.fleet("lab.list", "--json").out)[0]["address"] == "172.18.0.11"
