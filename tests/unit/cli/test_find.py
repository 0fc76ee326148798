from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.rollout import sighting
from fleet.rollout.sighting import Candidate, Sighting
from fleet.ssh import mdns, neighbours
from tests.support.homes import program

if TYPE_CHECKING:
    from tests.support.project import Project


def seen(
    address: str,
    *,
    port: int = 22,
    name: str = "",
    robot: str = "",
    key: str = "new",
    maker: str = "",
    here: bool = False,
    fingerprint: str = "",
) -> Sighting:
    return Sighting(
        candidate=Candidate(address=address, port=port, name=name, maker=maker),
        fingerprint=fingerprint or f"SHA256:{address}",
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
    assert "not found: away" in done.err
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


def test_each_computer_once(own: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot with a cable and Wi-Fi, a copy of a card, and one with another port."""
    found = (
        seen("192.0.2.5", name="pi1.local", robot="pi1", key="known", fingerprint="SHA256:x"),
        seen("127.0.0.1", robot="pi1", key="known", here=True, fingerprint="SHA256:x"),
        seen("192.0.2.6", name="pi1-2.local", robot="pi1", key="known", fingerprint="SHA256:x"),
        seen("192.0.2.8", port=2222),
        seen("fd00::8"),
    )
    monkeypatch.setattr(sighting, "candidates", lambda **_: ())
    monkeypatch.setattr(sighting, "sight", lambda *_, **__: found)
    done = own.fleet("find")
    rows = [row.split()[0] for row in done.out.splitlines()[1:]]
    assert sorted(rows) == ["127.0.0.1,", "192.0.2.6", "[192.0.2.8]:2222", "fd00::8"]
    assert "pi1 is at" not in done.err
    assert "pi1 (127.0.0.1) and pi1-2.local (192.0.2.6) have the same host key." in done.err
    assert ": {address: 192.0.2.8, port: 2222}\n" in done.err
    assert ': "fd00::8"\n' in done.err
    robots = {one["address"]: one for one in json.loads(own.fleet("find", "--json").out)}
    assert (robots["127.0.0.1"]["also"], robots["192.0.2.6"]["key"]) == (["192.0.2.5"], "copied")


def test_without_mdns(own: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence, and the rest is looked at."""

    def refused(**_: object) -> None:
        raise DesktopError("nobody can be asked by name", cure="connect this computer")

    monkeypatch.setattr(mdns, "browse", refused)
    monkeypatch.setattr(neighbours, "known", dict)
    done = own.fleet("find")
    assert "note: nobody can be asked by name; connect this computer" in done.err
    assert "127.0.0.1" in done.out


def test_nobody_is_around(own: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """Then there is a next step."""
    monkeypatch.setattr(sighting, "candidates", lambda **_: ())
    monkeypatch.setattr(sighting, "sight", lambda *_, **__: ())
    assert "nobody answers: `fleet find --scan`" in own.fleet("find").err


def test_a_robot_that_is_up(own: Project) -> None:
    """`fab await` lets scripts go on."""
    done = own.fleet("await", "--hosts", "pi1", "--timeout", "20")
    assert (done.code, "it is up" in done.out) == (0, True)
