from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.rollout import arrival, sighting
from fleet.rollout.sighting import Candidate, Sighting
from fleet.ssh import mdns, neighbours
from tests.support.homes import Told, program, start
from tests.support.sshd import known_line, make_key, public_key

if TYPE_CHECKING:
    from collections.abc import Iterable
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


CUT = """\
process=$PPID
while read -r name <"/proc/$process/comm" && [ "${name#sshd}" = "$name" ]; do
    process=$(awk '{ print $4 }' "/proc/$process/stat")
done
kill -KILL "$process"
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
    assert "`fab run --hosts pi1 -- cloud-init status --long`" in outcome.cure
    assert "`fab card --hosts pi1`" in outcome.cure
    program(sshds.folder, "pi1", called="cloud-init", text="#!/bin/sh\nexit 2\n")
    warned = "it is up, with warnings: `fab run --hosts pi1 -- cloud-init status --long`"
    assert waited(home.server).summary == warned


@pytest.mark.parametrize("restart", [CUT, "exit 143"], ids=["the link is lost", "the command is ended"])
def test_a_robot_that_restarts_in_its_first_boot(sshds: Sshds, restart: str) -> None:
    """Raspberry Pi OS does that: it is just not yet."""
    home = start(sshds, "pi1")
    once = f'#!/bin/sh\n[ -e "{home.path}/restarted" ] && exit 0\n: >"{home.path}/restarted"\n{restart}\n'
    program(sshds.folder, "pi1", called="cloud-init", text=once)
    outcome = waited(home.server)
    assert (outcome.status, outcome.summary) == ("done", "it is up")
    assert home.logins == 2


def test_a_first_boot_that_takes_longer_than_the_wait(sshds: Sshds, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cure waits on, and does not speak of power or Wi-Fi."""
    monkeypatch.setattr(arrival, "_LEAST", 0.5)
    home = start(sshds, "pi1")
    program(sshds.folder, "pi1", called="cloud-init", text="#!/bin/sh\nexec sleep 20\n")
    outcome = waited(home.server, timeout=0.2)
    assert outcome.status == "failed"
    assert outcome.reason.startswith("it is up, and its first boot is not over")
    assert "fab await --hosts pi1 --timeout" in outcome.cure
    assert "power" not in outcome.cure


def test_another_computer_at_its_address(sshd: Sshd, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its router gave the address away: it is looked for once, and nothing is waited for."""
    asked = []
    monkeypatch.setattr(arrival, "elsewhere", lambda robot, **_: asked.append(robot.name))
    other = make_key(sshd.known_hosts.parent / "other")
    sshd.known_hosts.write_text(known_line(sshd.known_as, public_key(other)))
    outcome = waited(sshd)
    assert (outcome.status, asked) == ("failed", [sshd.name])
    assert "CHANGED" in outcome.reason


def test_a_robot_at_another_address(sshd: Sshd, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only its recorded host key counts; the cure has the address."""
    there = Sighting(
        candidate=Candidate(address="192.0.2.44"), fingerprint="", key="known", robot="pi1", expected="pi1"
    )
    monkeypatch.setattr(mdns, "addresses", lambda _: ("192.0.2.44",))
    monkeypatch.setattr(neighbours, "greetings", lambda places: dict.fromkeys(places, "SSH-2.0"))
    monkeypatch.setattr(sighting, "sight", lambda *_, **__: (replace(there, robot=""), there))
    sshd.stop()
    outcome = waited(sshd)
    assert outcome.reason == "it is up at 192.0.2.44, by its host key, and not at 127.0.0.1"
    assert "write `address: 192.0.2.44`" in outcome.cure


def test_a_robot_that_was_never_trusted_is_looked_for_nowhere(sshd: Sshd, tmp_path: Path) -> None:
    """There is no host key to know it by."""
    robot = sshd.robot(known_hosts=tmp_path / "none")
    assert arrival.elsewhere(robot, name="pi1.local") is None


def test_it_is_looked_for_at_its_port(sshd: Sshd, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if nobody can be asked by name."""

    def refused(_: str) -> tuple[str, ...]:
        raise DesktopError("no network")

    monkeypatch.setattr(mdns, "addresses", refused)
    monkeypatch.setattr(neighbours, "known", lambda: {"127.0.0.2": ""})
    sshd.known_hosts.write_text(sshd.known_hosts.read_text().replace("127.0.0.1", "127.0.0.3"))
    places: list[tuple[str, int]] = []

    def nobody(found: Iterable[tuple[str, int]]) -> dict[tuple[str, int], str]:
        places.extend(found)
        return {}

    monkeypatch.setattr(neighbours, "greetings", nobody)
    arrival.elsewhere(sshd.robot().model_copy(update={"address": "127.0.0.3"}), name="pi1.local")
    assert places == [("127.0.0.2", sshd.port)]
