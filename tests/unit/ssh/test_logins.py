from __future__ import annotations

import contextlib
import getpass
import os
import shutil
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet.errors import LoginRefused
from fleet.ssh import connect
from tests.support.sshd import make_key

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.sshd import Sshd, Sshds


@contextlib.contextmanager
def agent(folder: Path, *keys: Path) -> Iterator[Path]:
    """A real ssh-agent that holds some keys."""
    path = folder / "agent"
    process = subprocess.Popen(("ssh-agent", "-D", "-a", path), stdout=subprocess.DEVNULL)
    try:
        while not path.exists():
            time.sleep(0.01)
        for key in keys:
            environment = {**os.environ, "SSH_AUTH_SOCK": str(path)}
            subprocess.run(("ssh-add", "-q", key), env=environment, check=True)
        yield path
    finally:
        process.kill()
        process.wait()


def test_a_key_with_a_passphrase_needs_an_agent(sshds: Sshds, sshd: Sshd) -> None:
    """There is nobody to type it; what does help is told."""
    key = make_key(sshds.folder / "locked", passphrase="secret")  # noqa: S106
    with pytest.raises(LoginRefused, match=f"{key} has a passphrase .`ssh-add {key}`"):
        sshds.log_in(sshd, identity=key)


def test_a_key_held_by_an_agent_logs_in(sshds: Sshds, monkeypatch: pytest.MonkeyPatch) -> None:
    """No file is read."""
    key = make_key(sshds.folder / "held")
    server = sshds.start(options=(f"AuthorizedKeysFile {key}.pub",))
    with agent(sshds.folder, key) as path:
        monkeypatch.setenv("SSH_AUTH_SOCK", str(path))
        sshds.configure(f"Host robot\n  HostName 127.0.0.1\n  Port {server.port}")
        with connect.connect(server.robot(address="robot"), config=sshds.config) as session:
            assert session.run(("echo", "in")).output == "in\n"


@pytest.mark.parametrize("beside", [True, False], ids=["with .pub", "without .pub"])
def test_an_agent_unlocks_the_key_that_is_named(sshds: Sshds, *, beside: bool) -> None:
    """IdentitiesOnly with a full agent: only the named key is offered, or the server would tire of the others."""
    key = make_key(sshds.folder / "locked")
    others = [make_key(sshds.folder / f"other{number}") for number in range(7)]
    server = sshds.start(options=(f"AuthorizedKeysFile {sshds.folder}/authorized", "MaxAuthTries 3"))
    shutil.copy(f"{key}.pub", sshds.folder / "authorized")
    with agent(sshds.folder, *others, key) as path:
        subprocess.run(("ssh-keygen", "-q", "-p", "-N", "secret", "-f", key), capture_output=True, check=True)
        if not beside:
            key.with_name("locked.pub").unlink()
        sshds.configure(f"Host *\n  IdentityAgent {path}")
        assert sshds.log_in(server, identity=key) == "in\n"


def test_an_agent_without_the_named_key_is_left_alone(sshds: Sshds) -> None:
    """IdentitiesOnly: the file is used, and the agent's seven others are not even offered."""
    others = [make_key(sshds.folder / f"other{number}") for number in range(7)]
    server = sshds.start(options=("MaxAuthTries 3",))
    with agent(sshds.folder, *others) as path:
        sshds.configure(f"Host *\n  IdentityAgent {path}")
        assert sshds.log_in(server) == "in\n"


def test_a_named_key_goes_before_the_agents_others(sshds: Sshds) -> None:
    """OpenSSH's order: else seven keys of an agent are refused, and the server hangs up before the right one."""
    others = [make_key(sshds.folder / f"other{number}") for number in range(7)]
    server = sshds.start(options=("MaxAuthTries 3",))
    with agent(sshds.folder, *others, server.identity) as path:
        sshds.configure(
            f"Host robot\n HostName 127.0.0.1\n Port {server.port}\n IdentityAgent {path}\n IdentityFile {server.identity}"
        )
        connect.connect(server.robot(address="robot"), config=sshds.config).close()


def test_too_many_keys_are_told_as_such(sshds: Sshds) -> None:
    """The server hangs up in mid-login, and that is not a network failure."""
    keys = [make_key(sshds.folder / f"other{number}") for number in range(7)]
    server = sshds.start(options=("MaxAuthTries 3",))
    with agent(sshds.folder, *keys) as path:
        sshds.configure(f"Host robot\n HostName 127.0.0.1\n Port {server.port}\n IdentityAgent {path}")
        with pytest.raises(LoginRefused, match=r"ended the login.*identity_file"):
            connect.connect(server.robot(address="robot"), config=sshds.config)


def test_a_wrong_key_is_refused_with_the_cure(sshds: Sshds, sshd: Sshd) -> None:
    """The cure can be pasted."""
    key = make_key(sshds.folder / "wrong")
    with pytest.raises(LoginRefused, match=f"{key} is refused") as refused:
        sshds.log_in(sshd, identity=key)
    assert refused.value.cure == f"ssh-copy-id -p {sshd.port} {getpass.getuser()}@127.0.0.1"


def test_a_login_by_password_only_is_refused_with_the_cure(sshds: Sshds) -> None:
    """With a key at hand and without."""
    server = sshds.start(options=("PubkeyAuthentication no", "PasswordAuthentication yes"))
    sshds.configure(f"Host robot\n  HostName 127.0.0.1\n  Port {server.port}")
    for robot in (server.robot(), server.robot(address="robot")):
        with pytest.raises(LoginRefused, match=r"accepts only password.*ssh-copy-id"):
            connect.connect(robot, config=sshds.config)


def test_a_login_that_wants_more_than_a_key_is_refused(sshds: Sshds) -> None:
    """A key that is taken, and not enough, is not a login."""
    server = sshds.start(options=("AuthenticationMethods publickey,password", "PasswordAuthentication yes"))
    with pytest.raises(LoginRefused, match="also requires password"):
        sshds.log_in(server)


def test_no_key_at_all_is_told(sshds: Sshds, sshd: Sshd, monkeypatch: pytest.MonkeyPatch) -> None:
    """A new computer: the first step is ssh-keygen."""
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    sshds.configure(f"Host robot\n  HostName 127.0.0.1\n  Port {sshd.port}")
    with pytest.raises(LoginRefused, match=r"there is no key.*ssh-keygen"):
        connect.connect(sshd.robot(address="robot"), config=sshds.config)


@pytest.mark.parametrize(
    ("name", "why"),
    [("garbage", "cannot be used"), ("missing", "No such file"), ("/proc/self/mem", "Input/output error")],
)
def test_a_key_file_that_cannot_be_read_is_told(sshds: Sshds, sshd: Sshd, name: str, why: str) -> None:
    """By its name, whatever is wrong with it."""
    (sshds.folder / "garbage").write_text("garbage\n")
    with pytest.raises(LoginRefused, match=f"{name} cannot be used.*{why}|{name} {why}"):
        sshds.log_in(sshd, identity=sshds.folder / name)


def test_a_private_key_that_others_can_read_is_not_used(sshds: Sshds, sshd: Sshd) -> None:
    """The server would take it; OpenSSH does not offer it, and the cure can be pasted."""
    sshd.identity.chmod(0o644)
    with pytest.raises(
        LoginRefused, match=r"id cannot be used .its mode 0644 lets others read it"
    ) as refused:
        sshds.log_in(sshd)
    assert refused.value.cure == f"chmod 600 {sshd.identity}"
    asked = ("ssh", "-F", sshds.config, "-o", "BatchMode=yes", "-o", "StrictHostKeyChecking=no")
    there = ("-i", sshd.identity, "-p", str(sshd.port), "127.0.0.1", "true")
    assert subprocess.run((*asked, *there), capture_output=True, check=False).returncode == 255
    sshd.identity.chmod(0o600)
    assert sshds.log_in(sshd) == "in\n"


def test_the_next_key_is_tried_after_one_that_others_can_read(sshds: Sshds) -> None:
    """As with OpenSSH."""
    open_key, good = make_key(sshds.folder / "open"), make_key(sshds.folder / "good")
    open_key.chmod(0o666)
    server = sshds.start(options=(f"AuthorizedKeysFile {good}.pub",))
    sshds.configure(
        f"Host robot\n HostName 127.0.0.1\n Port {server.port}\n IdentityFile {open_key}\n IdentityFile {good}"
    )
    connect.connect(server.robot(address="robot"), config=sshds.config).close()
