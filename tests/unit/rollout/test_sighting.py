from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.rollout import sighting
from fleet.rollout.sighting import Candidate, Register, Sighting
from fleet.ssh import mdns, neighbours
from fleet.ssh.known_hosts import HostKey
from fleet.ssh.mdns import Announced
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from tests.support.sshd import Sshd

OWN, OTHER, SHARED = (HostKey(kind="ssh-ed25519", blob=blob) for blob in (b"own", b"other", b"shared"))
REGISTER = Register(
    places={("192.168.1.7", 22): "pi7", ("192.168.1.8", 22): "pi8", ("192.168.1.9", 2222): "pi9"},
    keys={OWN.blob: ("pi7",), SHARED.blob: ("pi8", "pi9")},
    expected={"pi7": "pi7.local", "pi8": "192.168.1.8"},
)


@pytest.mark.parametrize(
    ("address", "key", "told"),
    [
        ("192.168.1.7", OWN, ("pi7", "known", True, False)),
        ("192.168.1.99", OWN, ("pi7", "known", False, True)),
        ("192.168.1.7", OTHER, ("pi7", "changed", True, False)),
        ("192.168.1.8", OTHER, ("pi8", "changed", True, False)),
        ("192.168.1.9", OTHER, ("", "new", False, False)),
        ("192.168.1.8", SHARED, ("pi8", "known", True, False)),
        ("192.168.1.50", OTHER, ("", "new", False, False)),
    ],
    ids=["at home", "moved", "reinstalled", "another one", "another port", "a key of two", "a stranger"],
)
def test_who_a_computer_is(address: str, key: HostKey, told: tuple[str, str, bool, bool]) -> None:
    """Its host key decides, and not its address, which a router gives to others."""
    one = REGISTER.sighting(Candidate(address=address), key)
    assert (one.robot, one.key, one.here, one.moved) == told


def test_a_robot_that_is_not_trusted_yet() -> None:
    """Its address tells who it may be; its port is that of the inventory."""
    known = Register(places={("192.168.1.9", 2222): "pi9"}, expected={"pi9": "pi9.local"})
    one = known.sighting(Candidate(address="192.168.1.9", port=2222), OTHER)
    assert (one.robot, one.key, one.here, one.candidate.where) == ("pi9", "new", True, "[192.168.1.9]:2222")


def seen(address: str, key: HostKey = OWN, name: str = "", port: int = 22) -> Sighting:
    return REGISTER.sighting(Candidate(address=address, name=name, port=port), key)


def shown(*sightings: Sighting) -> list[tuple[str, str, str, tuple[str, ...]]]:
    """Address, robot, state of the key, further addresses: of each computer."""
    return [
        (one.candidate.address, one.robot, one.key, tuple(other.address for other in one.also))
        for one in sighting.computers(sightings)
    ]


def test_a_robot_with_two_addresses_is_one_computer() -> None:
    """A cable and Wi-Fi, IPv4 and IPv6: where the inventory has it comes first, and so it has not moved."""
    assert shown(seen("192.168.1.70"), seen("fd00::7"), seen("192.168.1.7", name="pi7.local")) == [
        ("192.168.1.7", "pi7", "known", ("192.168.1.70", "fd00::7"))
    ]
    assert shown(seen("10.0.0.1", OTHER, "a.local"), seen("10.0.0.2", OTHER, "a.local")) == [
        ("10.0.0.1", "", "new", ("10.0.0.2",))
    ]
    assert shown(seen("10.0.0.1"), seen("10.0.0.2")) == [("10.0.0.1", "pi7", "known", ("10.0.0.2",))]
    assert shown(seen("10.0.0.1", OTHER), seen("10.0.0.2", OWN)) == [
        ("10.0.0.1", "", "new", ()),
        ("10.0.0.2", "pi7", "known", ()),
    ]


def test_a_copied_card_is_another_computer() -> None:
    """It announces another name. It is not said to be the robot, which is at home."""
    assert shown(seen("192.168.1.71", name="pi7-2.local"), seen("192.168.1.7", name="pi7.local")) == [
        ("192.168.1.7", "pi7", "known", ()),
        ("192.168.1.71", "", "copied", ()),
    ]


def test_two_robots_of_the_inventory_with_one_key_stay_two() -> None:
    """Each where the inventory has it."""
    assert shown(seen("192.168.1.8", SHARED), seen("192.168.1.9", SHARED, port=2222)) == [
        ("192.168.1.8", "pi8", "known", ()),
        ("192.168.1.9", "pi9", "known", ()),
    ]


def test_what_is_known_without_a_login() -> None:
    """The SSH server names its distribution, and the network card its maker."""
    pi = Candidate(address="", greeting="SSH-2.0-OpenSSH_9.2p1 Raspbian-2+deb12u3")
    assert (pi.system, pi.likely) == ("Raspberry Pi OS", True)
    debian = Candidate(address="", greeting="SSH-2.0-OpenSSH_10.0p2 Debian-7")
    assert (debian.system, debian.likely) == ("Debian", False)
    assert Candidate(address="", maker="NVIDIA Jetson").likely


def test_a_list_is_in_the_order_of_numbers() -> None:
    """As a person looks an address up in it."""
    places = (("fd00::1", 22), ("10.0.0.12", 22), ("10.0.0.9", 2222), ("10.0.0.9", 22))
    ordered = sorted(
        (Candidate(address=address, port=port) for address, port in places), key=lambda one: one.order
    )
    assert [one.where for one in ordered] == ["10.0.0.9", "[10.0.0.9]:2222", "10.0.0.12", "fd00::1"]


def test_everybody_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who announces itself, who is a neighbour, who is in the inventory; each address only with ``scan``."""
    announced = (
        Announced(name="pi7.local", addresses=("10.0.0.7", "fe80::7", "fd00::7"), port=2222),
        Announced(name="six.local", addresses=("fe80::6", "fd00::6")),
    )
    monkeypatch.setattr(mdns, "browse", lambda **_: announced)
    monkeypatch.setattr(neighbours, "known", lambda: {"10.0.0.8": "2c:cf:67:00:00:01"})
    monkeypatch.setattr(neighbours, "swept", lambda: ("10.0.0.9",))
    monkeypatch.setattr(neighbours, "greetings", lambda places: dict.fromkeys(places, "SSH-2.0-x"))
    found = sighting.candidates(also=(("10.0.0.1", 22),), ports=(2200,))
    assert [(one.where, one.name, one.maker) for one in found] == [
        ("[10.0.0.7]:2222", "pi7.local", ""),
        ("fd00::6", "six.local", ""),
        ("10.0.0.1", "", ""),
        ("10.0.0.8", "", "Raspberry Pi"),
        ("[10.0.0.8]:2200", "", "Raspberry Pi"),
    ]
    assert "10.0.0.9" in {one.address for one in sighting.candidates(scan=True)}


def test_without_mdns_the_others_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """And somebody is told why."""

    def refused(**_: object) -> None:
        raise DesktopError("port 5353 is taken")

    monkeypatch.setattr(mdns, "browse", refused)
    monkeypatch.setattr(neighbours, "known", dict)
    monkeypatch.setattr(neighbours, "greetings", lambda places: dict.fromkeys(places, "SSH-2.0-x"))
    told: list[DesktopError] = []
    assert sighting.candidates(also=(("10.0.0.1", 22),), on_problem=told.append)
    assert [str(one) for one in told] == ["port 5353 is taken"]


def test_a_robot_is_known_by_its_key(sshd: Sshd) -> None:
    """The register has the recorded keys of a robot, its address and its port; another robot may have the same key."""
    robot = sshd.robot()
    twin = robot.model_copy(update={"name": "twin"})
    register = sighting.register((robot, twin))
    assert register.expected == {robot.name: "127.0.0.1", "twin": "127.0.0.1"}
    assert register.places == {("127.0.0.1", sshd.port): robot.name}
    assert register.ports == frozenset({sshd.port})
    assert register.keys == {key.blob: (robot.name, "twin") for key in sshd.host_keys.values()}


def test_each_computer_is_asked_at_its_port(sshd: Sshd) -> None:
    """Who does not answer is left out."""
    register = sighting.register((sshd.robot(),))
    there = Candidate(address="127.0.0.1", port=sshd.port)
    nobody = Candidate(address="127.0.0.1", port=free_port())
    (one,) = sighting.sight((nobody, there), like=sshd.robot(), register=register)
    assert (one.candidate, one.robot, one.key, one.here) == (there, sshd.name, "known", True)
