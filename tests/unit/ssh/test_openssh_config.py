from __future__ import annotations

import getpass
import os
import pwd
import shlex
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Robot
from fleet.errors import DesktopError, Unreachable
from fleet.ssh import openssh_config
from fleet.ssh.connect import CONNECT_TIMEOUT, LINK_TIMEOUT

if TYPE_CHECKING:
    from fleet.ssh.openssh_config import Destination

HOME = Path(pwd.getpwuid(os.getuid()).pw_dir)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return tmp_path / "ssh config"


def robot(
    *, address: str = "pi1", user: str | None = None, port: int | None = None, identity: Path | None = None
) -> Robot:
    return Robot(
        name="leg",
        address=address,
        user=user,
        port=port,
        identity_file=identity,
        known_hosts=Path("known_hosts"),
    )


def resolve(config: Path, text: str, which: Robot | None = None) -> Destination:
    config.write_text(text, encoding="utf-8")
    return openssh_config.resolve(which or robot(), config=config)


def test_without_a_configuration_openssh_has_its_defaults(config: Path) -> None:
    """The names a person sees everywhere else."""
    found = resolve(config, "")
    assert (found.host, found.port, found.user, found.known_as) == ("pi1", 22, getpass.getuser(), "pi1")
    assert HOME / ".ssh/known_hosts" in found.known_hosts
    assert (found.only_named, found.via, found.proxy_command) == (False, (), "")
    assert [file for file in found.identity_files if not file.is_file()] == []


def test_the_inventory_goes_before_the_configuration(config: Path, tmp_path: Path) -> None:
    """Login, port and key; and then only that key is offered."""
    key = tmp_path / "key"
    key.touch()
    text = "Host *\n  User other\n  Port 77\n  IdentityFile ~/.ssh/other\n"
    found = resolve(config, text, robot(user="pi", port=2222, identity=key))
    assert (found.user, found.port, found.known_as) == ("pi", 2222, "[pi1]:2222")
    assert (found.identity_files, found.only_named) == ((key,), True)


def test_a_key_of_the_inventory_that_is_not_there_is_kept(config: Path, tmp_path: Path) -> None:
    """So that logging in tells that it is missing."""
    assert resolve(config, "", robot(identity=tmp_path / "gone")).identity_files[0] == tmp_path / "gone"


def test_every_keyword_that_matters_is_followed(config: Path, tmp_path: Path) -> None:
    """In an included file as well; tokens, variables and ~ are put in."""
    for name in ("pi1_key", "10.0.0.9_me", "a b"):
        (tmp_path / name).touch()
    (tmp_path / "included").write_text(
        f"Host PI1 pi1\n  HostName 10.0.0.9\n  User me\n  Port 2200\n  HostKeyAlias The-Leg\n"
        f"  IdentityFile {tmp_path}/%n_key\n  IdentityFile {tmp_path}/%h_%r\n  IdentityFile none\n"
        f'  IdentityFile "{tmp_path}/a b"\n  IdentitiesOnly yes\n  IdentityAgent ~/agent-%u\n'
        f'  UserKnownHostsFile "{tmp_path}/my hosts" ~/hosts\n  GlobalKnownHostsFile /etc/hosts-of-robots\n'
        f'  RevokedHostKeys "{tmp_path}/%h revoked"\n  HostKeyAlgorithms ssh-ed25519,rsa-sha2-512\n'
    )
    found = resolve(config, f"Include {tmp_path}/included\n")
    assert (found.host, found.port, found.user, found.known_as) == ("10.0.0.9", 2200, "me", "the-leg")
    assert found.identity_files == (tmp_path / "pi1_key", tmp_path / "10.0.0.9_me", tmp_path / "a b")
    assert found.only_named
    assert found.agent == f"{HOME}/agent-{getpass.getuser()}"
    assert found.known_hosts == (tmp_path / "my hosts", HOME / "hosts", Path("/etc/hosts-of-robots"))
    assert found.revoked == (tmp_path / "10.0.0.9 revoked",)
    assert found.host_key_algorithms == ("ssh-ed25519", "rsa-sha2-512")


@pytest.mark.parametrize(
    ("line", "agent"),
    [
        ("", "/env/agent"),
        ("IdentityAgent SSH_AUTH_SOCK", "/env/agent"),
        ("IdentityAgent none", ""),
        ("IdentityAgent $MINE", "/my"),
    ],
)
def test_the_agent_is_the_configured_one(
    config: Path, monkeypatch: pytest.MonkeyPatch, line: str, agent: str
) -> None:
    """Password managers and hardware keys bring their own agents."""
    monkeypatch.setenv("SSH_AUTH_SOCK", "/env/agent")
    monkeypatch.setenv("MINE", "/my")
    assert resolve(config, f"Host *\n  {line}\n").agent == agent


def test_the_tokens_of_a_proxy_command_are_put_in(config: Path, tmp_path: Path) -> None:
    """OpenSSH is asked to run the same command, and writes what it ran."""
    # Into a file, because ssh has words of its own on standard error.
    proxy = f"sh -c 'echo %h %p %r %n 100%% > {tmp_path}/ran'"
    text = f"Host *\n  HostName 127.0.0.9\n  User me\n  Port 2200\n  ProxyCommand {proxy}\n"
    ours = resolve(config, text).proxy_command
    subprocess.run(("ssh", "-T", "-F", config, "pi1"), capture_output=True, check=False)
    ran = (tmp_path / "ran").read_text(encoding="utf-8").strip()
    assert shlex.split(ours)[2] == f"echo {ran} > {tmp_path}/ran"


def test_jump_hosts_are_resolved_in_order(config: Path) -> None:
    """Each by its own entry; only the first may have jump hosts of its own, as with OpenSSH's client."""
    text = (
        "Host a\n  HostName 10.0.0.1\n  User ann\n  ProxyJump outer\n"
        "Host b\n  HostName 10.0.0.2\n  ProxyJump ignored\n"
        "Host pi1\n  ProxyJump a,bob@b:2200,[::1]:33\n"
    )
    via = resolve(config, text).via
    me = getpass.getuser()
    assert [(stop.user, stop.host, stop.port) for stop in via] == [
        (me, "outer", 22),
        ("ann", "10.0.0.1", 22),
        ("bob", "10.0.0.2", 2200),
        (me, "::1", 33),
    ]
    assert [stop.known_as for stop in via][-1] == "[::1]:33"
    assert {stop.via for stop in via} == {()}


def test_no_jump_is_none(config: Path) -> None:
    """ProxyJump none and ProxyCommand none take back what a later entry says."""
    found = resolve(config, "Host pi1\n  ProxyJump none\n  ProxyCommand none\nHost *\n  ProxyJump gate\n")
    assert (found.via, found.proxy_command) == ((), "")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Bogus yes\n", "Bad configuration option: bogus"),
        ("Host a\n  ProxyJump b\nHost b\n  ProxyJump a\nHost pi1\n  ProxyJump a\n", "forms a loop"),
        ("Host *\n  ProxyJump gate\n", "jumphost loop via gate"),
    ],
)
def test_a_configuration_that_cannot_work_is_told(config: Path, text: str, words: str) -> None:
    """In OpenSSH's own words where it has some."""
    with pytest.raises(Unreachable, match=f"{words}.*fix"):
        resolve(config, text)


def test_an_address_is_never_an_option(config: Path) -> None:
    """Whatever an inventory says."""
    with pytest.raises(Unreachable, match="rejects its configuration"):
        resolve(config, "", robot(address="-oProxyCommand=touch /tmp/x"))


def test_without_openssh_the_cure_is_told(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is what reads the configuration."""
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(DesktopError, match="install openssh-client"):
        resolve(config, "")


def test_login_is_what_a_person_would_type(tmp_path: Path) -> None:
    """OpenSSH reads from it the files it is meant to read, and asks nobody about new keys."""
    which = Robot(
        name="leg",
        address="pi1",
        user="pi",
        port=2222,
        identity_file=tmp_path / "key",
        known_hosts=tmp_path / "a b%",
    )
    argv = openssh_config.login(which)
    assert (argv[0], argv[-2:]) == ("ssh", ("--", "pi1"))
    said = subprocess.run((argv[0], "-G", *argv[1:]), capture_output=True, text=True, check=True).stdout
    values = dict(line.split(" ", 1) for line in said.splitlines() if " " in line)
    assert values["userknownhostsfile"].startswith(f"{tmp_path}/a b% {HOME}/.ssh/known_hosts")
    assert (values["stricthostkeychecking"], values["user"], values["port"]) == ("true", "pi", "2222")
    # A dead link is noticed, about as soon as by the other verbs.
    seconds = int(values["serveraliveinterval"]) * int(values["serveralivecountmax"])
    assert abs(seconds - LINK_TIMEOUT) < 5
    assert int(values["connecttimeout"]) == CONNECT_TIMEOUT


@pytest.mark.parametrize(
    ("port", "login"), [(22, "pi@pi1"), (2222, "-p 2222 pi@pi1")], ids=["usual port", "other port"]
)
def test_a_destination_reads_as_one_types_it(port: int, login: str) -> None:
    """Behind ssh and ssh-copy-id."""
    assert openssh_config.Destination(host="pi1", port=port, user="pi", known_as="pi1").login == login
