from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.rollout import sighting
from fleet.rollout.sighting import Candidate, Sighting
from tests.support.homes import program

if TYPE_CHECKING:
    from tests.support.project import Project


def seen(
    address: str, *, name: str = "", robot: str = "", key: str = "new", maker: str = "", here: bool = False
) -> Sighting:
    return Sighting(
        candidate=Candidate(address=address, name=name, maker=maker),
        fingerprint="SHA256:abc",
        key=key,
        robot=robot,
        expected="127.0.0.1" if robot else "",
        here=here,
    )


AROUND = (
    seen("192.0.2.9"),
    seen("192.0.2.7", name="robi.local", maker="Raspberry Pi"),
    seen("192.0.2.44", robot="pi1", key="known"),
)


@pytest.fixture
def around(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that moved, a Raspberry Pi, and another computer."""
    monkeypatch.setattr(sighting, "candidates", lambda **_: ())
    monkeypatch.setattr(sighting, "sight", lambda *_, **__: AROUND)


@pytest.mark.usefixtures("around")
def test_who_is_around(own: Project) -> None:
    """Robots of the inventory first, then likely ones; with lines for the inventory."""
    done = own.fleet("find")
    assert done.code == 0
    rows = done.out.splitlines()
    assert [row.split()[0] for row in rows[1:]] == ["192.0.2.44", "192.0.2.7", "192.0.2.9"]
    assert "pi1 (inventory: 127.0.0.1)" in rows[1]
    assert "Raspberry Pi" in rows[2]
    assert "pi1 is at 192.0.2.44; the inventory says 127.0.0.1" in done.err
    assert "away was not found" in done.err
    assert "  robi: robi.local\n" in done.err
    assert "  robot2: 192.0.2.9\n" in done.err


@pytest.mark.usefixtures("around")
def test_for_programs(own: Project) -> None:
    found = json.loads(own.fleet("find", "--json").out)
    assert {(one["robot"], one["key"], one["address"]) for one in found} == {
        ("pi1", "known", "192.0.2.44"),
        ("", "new", "192.0.2.7"),
        ("", "new", "192.0.2.9"),
    }


def test_the_model_of_a_robot_that_is_trusted(own: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is asked for it, after a login."""
    model = "Raspberry Pi 5 Model B"
    program(own.folder, "pi1", called="sh", text=f"#!/bin/sh\necho '{model}'\n")
    monkeypatch.setattr(sighting, "candidates", lambda **_: ())
    monkeypatch.setattr(
        sighting, "sight", lambda *_, **__: (seen("127.0.0.1", robot="pi1", key="known", here=True),)
    )
    assert model in own.fleet("find").out


def test_nobody_is_around(own: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """Then there is a next step."""
    monkeypatch.setattr(sighting, "candidates", lambda **_: ())
    monkeypatch.setattr(sighting, "sight", lambda *_, **__: ())
    assert "nobody answers: `fleet find --scan`" in own.fleet("find").err


def test_a_robot_that_is_up(own: Project) -> None:
    """`fab await` lets scripts go on."""
    done = own.fleet("await", "--hosts", "pi1", "--timeout", "20")
    assert (done.code, "it is up" in done.out) == (0, True)
