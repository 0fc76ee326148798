from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.cli import bundle
from fleet.errors import UsageError
from fleet.ssh import known_hosts
from fleet.ssh.known_hosts import HostKey
from tests.support.samples import PI
from tests.support.sshd import make_key

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.project import Project


def test_where_to_is_asked_before_anything_is_packed(own: Project) -> None:
    """A stick that is not mounted is a folder that is not there."""
    nowhere = own.fleet("bundle")
    assert (nowhere.code, "bundle --out /media/me/STICK" in nowhere.err) == (2, True)
    missing = own.fleet("bundle", "--out", str(own.folder / "STICK"))
    assert (missing.code, "mount the stick" in missing.err) == (2, True)


def test_what_ship_refuses_before_it_looks_at_a_robot_is_refused(own: Project) -> None:
    """Two robots with one address. A missing key is said before anything is packed, too."""
    (own.folder / "STICK").mkdir()
    nowhere = own.fleet("bundle", "--out", "STICK", "--sign", "no-key")
    assert (nowhere.code, "there is no key no-key" in nowhere.err) == (2, True)
    (own.folder / "inventory.yaml").write_text("robots: {pi1: 192.0.2.1, pi2: 192.0.2.1}\n")
    twins = own.fleet("bundle", "--hosts", "pi1", "--out", "STICK")
    assert (twins.code, "have the same address" in twins.err) == (2, True), twins
    assert list((own.folder / "STICK").iterdir()) == []


def test_ship_from_something_else_is_refused(own: Project) -> None:
    """Before any robot is asked."""
    done = own.fleet("ship", "--hosts", "pi1", "--from", str(own.folder))
    assert (done.code, "is not a bundle of fleet" in done.err) == (2, True)


def test_a_signature_is_one_that_openssh_checks(tmp_path: Path) -> None:
    """With the namespace that `install` asks for."""
    key = make_key(tmp_path / "key")
    (tmp_path / "sig").write_bytes(bundle._signature(b"text", key=tmp_path / "key"))  # noqa: SLF001
    public = subprocess.run(("ssh-keygen", "-y", "-f", str(key)), capture_output=True, text=True, check=True)
    (tmp_path / "allowed").write_text(f"fleet {public.stdout}")
    check = ("ssh-keygen", "-Y", "verify", "-f", "allowed", "-I", "fleet", "-n", "fleet-bundle", "-s", "sig")
    done = subprocess.run(check, cwd=tmp_path, input=b"text", capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    with pytest.raises(UsageError, match="did not sign"):
        bundle._signature(b"text", key=tmp_path / "no-key")  # noqa: SLF001


def test_the_recorded_host_keys_of_a_robot_go_with_it(tmp_path: Path) -> None:
    """By them it is recognized; one that nobody has trusted has none."""
    robot = PI.model_copy(update={"known_hosts": tmp_path / "known_hosts"})
    assert bundle._keys(robot) == ()  # noqa: SLF001
    key = HostKey(kind="ssh-ed25519", blob=b"\0\0\0\x0bssh-ed25519\0\0\0\1x")
    known_hosts.record(robot.known_hosts, name="pi1.local", key=key)
    assert bundle._keys(robot) == (("ssh-ed25519", "AAAAC3NzaC1lZDI1NTE5AAAAAXg="),)  # noqa: SLF001
