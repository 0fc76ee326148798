from __future__ import annotations

import json
import subprocess
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import ROOT, eventually

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.lab.conftest import Pi
    from tests.support.lab_project import Project, Said


@pytest.fixture
def stranger(project: Project, pi: Pi) -> Project:
    """A project that never met the robots: its own known_hosts is empty."""
    write(project, pi, key=pi.key)
    return project


def write(project: Project, pi: Pi, *, key: Path) -> None:
    script = {"script": str(ROOT / "fleet" / "lab" / "recipe" / "get-docker.sh")}
    robot = {"address": pi.address, "user": "pi", "identity_file": str(key), "docker": script}
    project.write("inventory.yaml", json.dumps({"stack": "docker/compose.yaml", "robots": {"pi1": robot}}))


def told(said: Said) -> tuple[str, str, str]:
    (outcome,) = said.json
    return outcome["status"], outcome["reason"], outcome["cure"]


@contextmanager
def sshd(pi: Pi, *settings: str) -> Iterator[None]:
    """With another configuration of the robot's sshd."""
    path = "/etc/ssh/sshd_config.d/test.conf"
    pi.exec("sh", "-c", f'printf "%s\\n" "$@" > {path}; systemctl reload ssh', "sh", *settings)
    try:
        yield
    finally:
        pi.exec("sh", "-c", f"rm {path}; systemctl reload ssh")


@contextmanager
def another_host_key(pi: Pi) -> Iterator[None]:
    """With the host keys of a robot that was set up again."""
    new = "mkdir /root/keys && mv /etc/ssh/ssh_host_* /root/keys && ssh-keygen -q -A && systemctl restart ssh"
    old = "rm /etc/ssh/ssh_host_* && mv /root/keys/* /etc/ssh && rmdir /root/keys && systemctl restart ssh"
    pi.exec("sh", "-c", new)
    try:
        yield
    finally:
        pi.exec("sh", "-c", old)
        assert eventually(lambda: pi.ssh("true").returncode == 0)


def fingerprint(pi: Pi) -> str:
    return pi.exec("ssh-keygen", "-lf", "/etc/ssh/ssh_host_ed25519_key.pub").split()[1]


def test_an_unknown_host_key_is_refused_until_it_is_trusted(stranger: Project, pi: Pi) -> None:
    """Every verb refuses it; `fab trust` shows the fingerprint that the robot itself shows, and records it."""
    for line in (("ship", "--json"), ("provision", "--json")):
        said = stranger.fab(*line)
        status, reason, cure = told(said)
        assert (said.code, status) == (1, "failed")
        assert "host key" in reason
        assert "fab trust" in cure
    assert "host key" in stranger.fab("status").out
    shown = stranger.fab("trust")  # nobody is there to say yes
    assert fingerprint(pi) in shown.all
    assert not (stranger.directory / "known_hosts").exists()
    recorded = stranger.well("trust", "--yes")
    assert fingerprint(pi) in recorded.all
    stranger.well("ship")
    assert stranger.well("trust", "--json").status == {"pi1": "unchanged"}


def test_a_changed_host_key_is_refused_until_a_person_says_so(stranger: Project, pi: Pi) -> None:
    """A robot that was set up again, or somebody in between: only `--changed` replaces the key."""
    stranger.well("trust", "--yes")
    known = (stranger.directory / "known_hosts").read_text()
    with another_host_key(pi):
        said = stranger.fab("ship", "--json")
        assert (said.code, told(said)[0]) == (1, "failed")
        assert "changed" in told(said)[1]
        kept = stranger.fab("trust", "--yes", "--json")
        assert (kept.code, told(kept)[0], "fab trust --changed" in told(kept)[2]) == (1, "failed", True)
        assert (stranger.directory / "known_hosts").read_text() == known
        assert fingerprint(pi) in stranger.well("trust", "--yes", "--changed").all
        stranger.well("ship")
    assert stranger.fab("ship").code == 1


def test_a_key_that_the_robot_does_not_know(stranger: Project, pi: Pi, tmp_path: Path) -> None:
    """The login is refused: which key was tried, and how it gets there."""
    key = tmp_path / "other_key"
    subprocess.run(("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)), check=True)
    write(stranger, pi, key=key)
    stranger.well("trust", "--yes")
    said = stranger.fab("ship", "--json")
    status, reason, cure = told(said)
    assert (said.code, status) == (1, "failed")
    assert f"{pi.address} does not let pi in" in reason
    assert "other_key" in reason
    assert "ssh-copy-id" in cure


def test_a_robot_that_takes_passwords_only(stranger: Project, pi: Pi) -> None:
    """Said as what it is, with the way to a key; nobody is asked for a password in the middle of a fleet."""
    stranger.well("trust", "--yes")
    with sshd(pi, "PubkeyAuthentication no"):
        said = stranger.fab("ship", "--json")
    status, reason, cure = told(said)
    assert (said.code, status) == (1, "failed")
    assert "password" in reason
    assert "PubkeyAuthentication" in cure or "ssh-copy-id" in cure


def test_sudo_that_asks_for_a_password_matters_to_provision_only(stranger: Project, pi: Pi) -> None:
    """Shipping needs no root; `provision`, where it has something to do, says what sudo lacks."""
    stranger.well("trust", "--yes")
    rule = "/etc/sudoers.d/010_pi-nopasswd"
    pi.exec("sh", "-c", f"mv {rule} /root/rule; mv /etc/docker/daemon.json /root/daemon.json")
    try:
        said = stranger.fab("provision", "--json")
        stranger.well("ship")
    finally:
        pi.exec("sh", "-c", f"mv /root/rule {rule}; mv /root/daemon.json /etc/docker/daemon.json")
    assert said.code == 1
    assert "sudo asks pi for a password" in told(said)[1]
