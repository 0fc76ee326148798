from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.rollout import sighting
from fleet.rollout.sighting import Candidate, Register
from fleet.ssh import mdns, neighbours
from fleet.ssh.known_hosts import HostKey
from fleet.ssh.mdns import Announced

if TYPE_CHECKING:
    from tests.support.sshd import Sshd

OWN, OTHER = HostKey(kind="ssh-ed25519", blob=b"own"), HostKey(kind="ssh-ed25519", blob=b"other")
REGISTER = Register(
    addresses={"192.168.1.7": "pi7", "192.168.1.8": "pi8"},
    keys={OWN.blob: "pi7"},
    expected={"pi7": "pi7.local", "pi8": "192.168.1.8"},
)


@pytest.mark.parametrize(
    ("address", "key", "told"),
    [
        ("192.168.1.7", OWN, ("pi7", "known", True, False)),
        ("192.168.1.99", OWN, ("pi7", "known", False, True)),
        ("192.168.1.7", OTHER, ("pi7", "changed", True, False)),
        ("192.168.1.8", OTHER, ("pi8", "new", True, False)),
        ("192.168.1.50", OTHER, ("", "new", False, False)),
    ],
    ids=["at home", "moved", "reinstalled", "not trusted yet", "a stranger"],
)
def test_who_a_computer_is(address: str, key: HostKey, told: tuple[str, str, bool, bool]) -> None:
    """Its host key decides, and not its address, which a router gives to others."""
    one = REGISTER.sighting(Candidate(address=address), key)
    assert (one.robot, one.key, one.here, one.moved) == told


def test_what_is_known_without_a_login() -> None:
    """The SSH server names its distribution, and the network card its maker."""
    pi = Candidate(address="", greeting="SSH-2.0-OpenSSH_9.2p1 Raspbian-2+deb12u3")
    assert (pi.system, pi.likely) == ("Raspberry Pi OS", True)
    debian = Candidate(address="", greeting="SSH-2.0-OpenSSH_10.0p2 Debian-7")
    assert (debian.system, debian.likely) == ("Debian", False)
    assert Candidate(address="", maker="NVIDIA Jetson").likely


def test_everybody_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who announces itself, who is a neighbour, who is in the inventory; each address only with ``scan``."""
    announced = (Announced(name="pi7.local", addresses=("10.0.0.7", "fe80::7")),)
    monkeypatch.setattr(mdns, "browse", lambda **_: announced)
    monkeypatch.setattr(neighbours, "known", lambda: {"10.0.0.8": "2c:cf:67:00:00:01"})
    monkeypatch.setattr(neighbours, "swept", lambda: ("10.0.0.9",))
    monkeypatch.setattr(neighbours, "greetings", lambda addresses: dict.fromkeys(addresses, "SSH-2.0-x"))
    found = sighting.candidates(also=("10.0.0.1",))
    assert [(one.address, one.name, one.maker) for one in found] == [
        ("10.0.0.7", "pi7.local", ""),
        ("10.0.0.1", "", ""),
        ("10.0.0.8", "", "Raspberry Pi"),
    ]
    assert "10.0.0.9" in {one.address for one in sighting.candidates(scan=True)}


def test_a_robot_is_known_by_its_key(sshd: Sshd) -> None:
    """The register has the recorded keys of a robot, and its address; a stranger's key is told as new."""
    robot = sshd.robot()
    register = sighting.register((robot,))
    assert register.expected == {robot.name: "127.0.0.1"}
    assert register.addresses == {"127.0.0.1": robot.name}
    assert set(register.keys) == {key.blob for key in sshd.host_keys.values()}


def test_who_does_not_answer_is_left_out(sshd: Sshd) -> None:
    """Nobody listens on port 22 of this address."""
    register = sighting.register((sshd.robot(),))
    assert sighting.sight((Candidate(address="127.255.255.254"),), like=sshd.robot(), register=register) == ()
