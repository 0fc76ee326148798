from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.rollout import arrival, sighting
from fleet.rollout.sighting import Candidate, Sighting
from fleet.ssh import mdns, neighbours
from tests.support.homes import Told, program, start

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.plan.outcome import Outcome
    from tests.support.sshd import Sshd, Sshds

FAILED = """\
#!/bin/sh
echo 'status: error'
echo 'errors:'
echo '	- (users-groups, group operator exists)'
exit 1
"""


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody else is in the network, and nobody is asked."""
    monkeypatch.setattr(mdns, "addresses", lambda _: ())
    monkeypatch.setattr(neighbours, "known", dict)
    monkeypatch.setattr(arrival, "_PAUSE", 0.1)


def waited(server: Sshd, *, timeout: float = 20.0) -> Outcome:
    (outcome,) = arrival.wait((server.robot(),), timeout=timeout, progress=Told())
    return outcome


def test_a_robot_that_comes_up_later(sshd: Sshd) -> None:
    """It boots while we wait."""
    sshd.stop()
    later = threading.Timer(1.0, sshd.again)
    later.start()
    outcome = waited(sshd)
    later.join()
    assert (outcome.status, outcome.summary) == ("done", "it is up")


def test_a_robot_that_does_not_come_up(sshd: Sshd) -> None:
    """The time is over, and the last reason is told."""
    sshd.stop()
    began = time.monotonic()
    outcome = waited(sshd, timeout=1.0)
    assert time.monotonic() - began < 10
    assert outcome.status == "unreachable"
    assert outcome.reason.startswith("it has not come up: ")
    assert "fab find --scan" in outcome.cure


def test_a_first_boot_that_failed(sshds: Sshds) -> None:
    """cloud-init tells why, and the robot is not said to be ready."""
    home = start(sshds, "pi1")
    program(sshds.folder, "pi1", called="cloud-init", text=FAILED)
    outcome = waited(home.server)
    assert outcome.status == "failed"
    assert outcome.reason == "cloud-init failed at its first boot: (users-groups, group operator exists)"
    program(sshds.folder, "pi1", called="cloud-init", text="#!/bin/sh\nexit 2\n")
    assert waited(home.server).summary.startswith("it is up, with warnings")


def test_a_robot_at_another_address(sshd: Sshd, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only its recorded host key counts; the cure has the address."""
    there = Sighting(
        candidate=Candidate(address="192.0.2.44"), fingerprint="", key="known", robot="pi1", expected="pi1"
    )
    monkeypatch.setattr(mdns, "addresses", lambda _: ("192.0.2.44",))
    monkeypatch.setattr(neighbours, "greetings", lambda addresses: dict.fromkeys(addresses, "SSH-2.0"))
    monkeypatch.setattr(sighting, "sight", lambda *_, **__: (replace(there, robot=""), there))
    sshd.stop()
    outcome = waited(sshd)
    assert outcome.reason == "it is up at 192.0.2.44, by its host key, and not at 127.0.0.1"
    assert "write `address: 192.0.2.44`" in outcome.cure


def test_a_robot_that_was_never_trusted_is_looked_for_nowhere(sshd: Sshd, tmp_path: Path) -> None:
    """There is no host key to know it by."""
    robot = sshd.robot(known_hosts=tmp_path / "none")
    assert arrival.elsewhere(robot, name="pi1.local") is None
