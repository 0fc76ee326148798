from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.plan.outcome import Outcome
from fleet.rollout import trust
from fleet.ssh import connect
from tests.support.homes import Told, statuses
from tests.support.sshd import Sshd, free_port, known_line, make_key, public_key

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.rollout.trust import Offer
    from tests.support.sshd import Sshds


@pytest.fixture
def server(sshds: Sshds) -> Sshd:
    """A robot whose key nobody has recorded yet."""
    return sshds.start("pi1", trusted=False)


@pytest.fixture
def other_key(tmp_path: Path) -> Path:
    return make_key(tmp_path / "another machine")


def looked(*servers: Sshd) -> tuple[Offer, ...]:
    offers, missing = trust.offered_keys([server.robot() for server in servers], progress=Told())
    assert missing == ()
    return offers


def changed(server: Sshd, other: Path) -> None:
    """Another key than the server's is on record."""
    server.known_hosts.write_text(known_line(server.known_as, public_key(other)))


def test_the_key_a_robot_offers(server: Sshd) -> None:
    """Nobody logs in, nothing is written; the fingerprint is what ``ssh-keygen -lf`` prints on the robot."""
    (offer,) = looked(server)
    file = server.log.parent.parent / "host_ed25519.pub"
    printed = subprocess.run(
        ("ssh-keygen", "-lf", str(file)), capture_output=True, text=True, check=True
    ).stdout
    assert offer.key.fingerprint in printed
    assert offer.text() == f"pi1  {server.known_as}  ssh-ed25519  {offer.key.fingerprint}  unknown"
    assert not server.known_hosts.exists()
    assert "Accepted" not in server.log.read_text()


def test_recording_lets_fleet_and_openssh_in(server: Sshd) -> None:
    """A recorded key is known from then on, to OpenSSH too."""
    trust.record(looked(server))
    (offer,) = looked(server)
    assert offer.verdict == "known"
    with connect.connect(server.robot()) as session:
        assert session.run(("echo", "in")).output == "in\n"
    found = subprocess.run(
        ("ssh-keygen", "-F", server.known_as, "-f", str(server.known_hosts)), capture_output=True, check=False
    )
    assert found.returncode == 0


def test_a_changed_key_takes_the_place_of_the_old_one_when_the_person_says_so(
    server: Sshd, other_key: Path
) -> None:
    """Not beside it: the machine that was there before is not believed any more."""
    changed(server, other_key)
    offers = looked(server)
    assert offers[0].verdict == "changed"
    assert trust.to_record(offers, changed=False) == ()
    trust.record(trust.to_record(offers, changed=True))
    assert server.known_hosts.read_text() == known_line(server.known_as, server.host_keys["ed25519"])


def test_a_revoked_key_is_never_recorded(server: Sshd) -> None:
    """Whatever the person says."""
    server.known_hosts.write_text("@revoked " + known_line("*", server.host_keys["ed25519"]))
    offers = looked(server)
    assert offers[0].verdict == "revoked"
    assert trust.to_record(offers, changed=True) == ()


def test_robots_that_cannot_be_asked_do_not_keep_the_others_from_it(sshds: Sshds, server: Sshd) -> None:
    """Offers of those that answer, in order; outcomes of those that do not."""
    second = sshds.start("pi3", trusted=False)
    away = server.robot().model_copy(update={"name": "pi2", "port": free_port()})
    offers, missing = trust.offered_keys([second.robot(), away, server.robot()], progress=Told())
    assert [offer.robot.name for offer in offers] == ["pi3", "pi1"]
    assert statuses(missing) == {"pi2": "unreachable"}


def test_what_became_of_an_offer(server: Sshd, other_key: Path) -> None:
    """Recorded, known already, or refused with what can be done."""
    (unknown,) = looked(server)
    key = f"ssh-ed25519 {unknown.key.fingerprint}"
    assert trust.outcome(unknown, recorded=True, dry=False) == Outcome(
        robot="pi1", status="done", summary=f"recorded {key}"
    )
    assert trust.outcome(unknown, recorded=True, dry=True) == Outcome(
        robot="pi1", status="planned", summary=f"would record {key}"
    )
    refused = trust.outcome(unknown, recorded=False, dry=False)
    assert refused.reason == f"its host key is unknown and was not recorded: {key}"
    assert "--yes" in refused.cure
    changed(server, other_key)
    assert "`fab trust --changed`" in trust.outcome(looked(server)[0], recorded=False, dry=False).cure
    trust.record(looked(server))
    assert trust.outcome(looked(server)[0], recorded=False, dry=False) == Outcome(
        robot="pi1", status="unchanged", summary=f"known {key}"
    )
