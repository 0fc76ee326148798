from __future__ import annotations

import contextlib
import getpass
import os
import resource
import shutil
import signal
import socket
import subprocess
import threading
import time
from typing import TYPE_CHECKING

import pytest

from fleet.errors import LinkLost, LoginRefused, Unreachable, UntrustedHostKey
from fleet.ssh import connect
from tests.support.sshd import known_line, make_key, public_key

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.sshd import Sshd, Sshds


def test_a_known_host_key_is_let_in(sshds: Sshds, sshd: Sshd) -> None:
    """The usual case; the files are read, never written."""
    before = sshd.known_hosts.read_bytes()
    assert sshds.log_in(sshd) == "in\n"
    assert sshd.known_hosts.read_bytes() == before


def test_an_unknown_host_key_is_refused(sshds: Sshds) -> None:
    """Nobody is trusted by default, and the cure is told."""
    server = sshds.start(trusted=False)
    with pytest.raises(UntrustedHostKey, match="not known yet") as refused:
        sshds.log_in(server)
    assert server.host_keys["ed25519"].fingerprint in refused.value.what
    assert "fab trust" in refused.value.cure


def test_a_changed_host_key_is_refused(sshds: Sshds) -> None:
    """Another machine at that address does not get our commands; the file and line of the old key are told."""
    server = sshds.start(trusted=False)
    other = public_key(make_key(sshds.folder / "other"))
    sshds.known_hosts.write_text(known_line(server.known_as, other), encoding="utf-8")
    with pytest.raises(UntrustedHostKey, match=rf"CHANGED.*{sshds.known_hosts}:1"):
        sshds.log_in(server)


def test_a_revoked_host_key_is_refused(sshds: Sshds, sshd: Sshd) -> None:
    """Though it is known as well."""
    with sshd.known_hosts.open("a", encoding="utf-8") as file:
        file.write("@revoked " + known_line("*", sshd.host_keys["ed25519"]))
    with pytest.raises(UntrustedHostKey, match="revoked"):
        sshds.log_in(sshd)


def test_a_host_key_that_the_configuration_revokes_is_refused(sshds: Sshds, sshd: Sshd) -> None:
    """It is in known_hosts as well: OpenSSH refuses it, and so do we, also to record it."""
    (sshds.folder / "revoked").write_text(known_line("", sshd.host_keys["ed25519"]).lstrip())
    sshds.configure(f"Host *\n  RevokedHostKeys {sshds.folder}/revoked")
    with pytest.raises(UntrustedHostKey, match=f"is revoked by {sshds.folder}/revoked"):
        sshds.log_in(sshd)
    with pytest.raises(UntrustedHostKey, match=f"is revoked by {sshds.folder}/revoked"):
        connect.offered_key(sshd.robot(), config=sshds.config)


def test_only_host_key_algorithms_of_the_configuration_are_accepted(sshds: Sshds) -> None:
    """A person may trust some kinds of keys no more."""
    server = sshds.start(host_keys=("ed25519", "rsa"))
    sshds.configure("Host *\n  HostKeyAlgorithms rsa-sha2-512")
    assert connect.offered_key(server.robot(), config=sshds.config)[1].kind == "ssh-rsa"
    assert sshds.log_in(server) == "in\n"
    sshds.configure("Host *\n  HostKeyAlgorithms ecdsa-sha2-nistp256")
    with pytest.raises(Unreachable, match="broke off the key exchange"):
        sshds.log_in(server)


@pytest.mark.skipif(
    subprocess.run(
        ("ssh", "-G", "-o", "RequiredRSASize=3072", "pi1"), capture_output=True, check=False
    ).returncode
    != 0,
    reason="OpenSSH has RequiredRSASize from 9.1 on",
)
def test_rsa_keys_that_are_too_short_for_the_configuration_are_refused(sshds: Sshds) -> None:
    """The robot's and one's own; ssh-keygen makes 3072 bits."""
    mine = make_key(sshds.folder / "mine", kind="rsa")
    server = sshds.start(host_keys=("rsa",), options=(f"AuthorizedKeysFile {mine}.pub",))
    sshds.configure("Host *\n  RequiredRSASize 3072")
    assert sshds.log_in(server, identity=mine) == "in\n"
    sshds.configure("Host *\n  RequiredRSASize 4096")
    with pytest.raises(UntrustedHostKey, match="has 3072 bits, and RequiredRSASize is 4096"):
        sshds.log_in(server, identity=mine)
    other = sshds.start("other", options=(f"AuthorizedKeysFile {mine}.pub",))
    with pytest.raises(
        LoginRefused, match=r"mine cannot be used .it has 3072 bits, and RequiredRSASize is 4096"
    ):
        sshds.log_in(other, identity=mine)


@pytest.mark.parametrize(
    ("first", "then", "why"),
    [
        (b"", b"x" * 65536, "sends no SSH banner"),
        (b"x" * 100_000 + b"\n", b"x\n" * 30_000, "is not an SSH server: Indecipherable"),
        (b"SSH-2.0-Liar\r\n\x7f\xff\xff\xfc", b"\x14" * 65536, "announced a packet of 2147483"),
    ],
    ids=["no banner", "many banners", "a packet of 2 GB"],
)
def test_a_device_that_is_no_robot_cannot_fill_our_memory(
    sshds: Sshds, sshd: Sshd, first: bytes, then: bytes, why: str
) -> None:
    """It has proved nothing yet, and sends without end."""

    def flood(listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                caller = listener.accept()[0]
                with caller, contextlib.suppress(OSError):
                    caller.sendall(first)
                    while True:
                        caller.sendall(then)

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=flood, args=(listener,), daemon=True).start()
        liar = sshd.robot().model_copy(update={"port": listener.getsockname()[1]})
        with pytest.raises(Unreachable, match=why) as refused:
            connect.connect(liar, connect_timeout=3, config=sshds.config)
    assert len(refused.value.what) < 600
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


@pytest.mark.parametrize("kind", ["rsa", "ecdsa", "ed25519"])
def test_one_known_key_of_several_is_enough(sshds: Sshds, kind: str) -> None:
    """The server is asked for the type we know: its others would look like another machine."""
    server = sshds.start(host_keys=("ed25519", "ecdsa", "rsa"), trusted=False)
    lines = "@cert-authority " + known_line("*", server.host_keys["ed25519"])
    lines += known_line(server.known_as, server.host_keys[kind])
    sshds.known_hosts.write_text(lines, encoding="utf-8")
    assert sshds.log_in(server) == "in\n"


def test_the_users_own_known_hosts_counts_and_is_not_written(sshds: Sshds, tmp_path: Path) -> None:
    """Whom `ssh` knows, we know; hashed as Debian's OpenSSH writes it, in a file with a space in its name."""
    server = sshds.start(trusted=False)
    own = tmp_path / "known hosts"
    own.write_text(known_line(server.known_as, server.host_keys["ed25519"]), encoding="utf-8")
    subprocess.run(("ssh-keygen", "-q", "-H", "-f", own), capture_output=True, check=True)
    before = own.read_bytes()
    sshds.configure(f'UserKnownHostsFile "{own}" {tmp_path}/none')
    assert sshds.log_in(server) == "in\n"
    assert own.read_bytes() == before


def test_offered_key_is_the_servers_and_needs_no_login(sshds: Sshds) -> None:
    """`fab trust` sees the key of a robot that does not let us in yet."""
    server = sshds.start(options=("AuthorizedKeysFile none",), trusted=False)
    name, key = connect.offered_key(server.robot(), config=sshds.config)
    assert (name, key) == (f"[127.0.0.1]:{server.port}", server.host_keys["ed25519"])
    assert not sshds.known_hosts.exists()


def test_offered_key_of_several_is_the_one_on_record(sshds: Sshds) -> None:
    """So that a second `fab trust` says known, not changed."""
    server = sshds.start(host_keys=("ed25519", "rsa"), trusted=False)
    sshds.known_hosts.write_text(known_line(server.known_as, server.host_keys["rsa"]), encoding="utf-8")
    assert connect.offered_key(server.robot(), config=sshds.config)[1] == server.host_keys["rsa"]


def test_an_alias_of_an_included_configuration_is_followed(sshds: Sshds, sshd: Sshd, tmp_path: Path) -> None:
    """Address, port, user, key and the name in known_hosts may all come from there."""
    included = tmp_path / "included"
    included.write_text(
        f"Host leg\n  HostName 127.0.0.1\n  Port {sshd.port}\n  User {getpass.getuser()}\n"
        f"  IdentityFile {sshd.identity}\n  IdentitiesOnly yes\n  HostKeyAlias the-leg\n"
    )
    sshds.configure(f"Include {included}")
    robot = sshd.robot(address="leg")
    assert connect.offered_key(robot, config=sshds.config)[0] == "the-leg"
    with pytest.raises(UntrustedHostKey, match="the-leg"):
        connect.connect(robot, config=sshds.config)
    sshds.known_hosts.write_text(known_line("the-leg", sshd.host_keys["ed25519"]), encoding="utf-8")
    with connect.connect(robot, config=sshds.config) as session:
        assert session.run(("id", "-un")).output.strip() == getpass.getuser()


def through(sshds: Sshds, jump: Sshd, robot: Sshd, *, options: str = "") -> None:
    """Write a configuration in which the robot is behind the jump host."""
    sshds.configure(
        f"Host gate\n  HostName 127.0.0.1\n  Port {jump.port}\n  User {getpass.getuser()}\n"
        f"  IdentityFile {jump.identity}\n{options}"
        f"Host inner\n  HostName 127.0.0.1\n  Port {robot.port}\n  User {getpass.getuser()}\n"
        f"  IdentityFile {robot.identity}\n  ProxyJump gate\n"
    )


def test_a_robot_behind_a_jump_host_is_reached(sshds: Sshds) -> None:
    """Bytes go through, and closing ends both connections."""
    jump, inner = sshds.start("jump"), sshds.start("inner")
    through(sshds, jump, inner)
    with connect.connect(inner.robot(address="inner"), config=sshds.config) as session:
        said = session.run(("wc", "-c"), feed=(bytes(1 << 20) for _ in range(20)))
        assert said.output.strip() == str(20 << 20)
    assert "Accepted publickey" in jump.log.read_text()
    deadline = time.monotonic() + 10
    while (len(jump.processes()), len(inner.processes())) != (1, 1) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert (len(jump.processes()), len(inner.processes())) == (1, 1)


def test_a_jump_hosts_key_is_checked_too(sshds: Sshds) -> None:
    """Whoever sits between sees nothing, not even by `fab trust`."""
    jump, inner = sshds.start("jump", trusted=False), sshds.start("inner")
    sshds.known_hosts.write_text(known_line(inner.known_as, inner.host_keys["ed25519"]), encoding="utf-8")
    through(sshds, jump, inner)
    for act in (connect.connect, connect.offered_key):
        with pytest.raises(UntrustedHostKey, match=rf"\[127.0.0.1\]:{jump.port} is not known yet.*jump host"):
            act(inner.robot(address="inner"), config=sshds.config)


def test_a_jump_host_that_cannot_reach_the_robot_says_so(sshds: Sshds) -> None:
    """The failure is told as the robot's, with the jump host named."""
    jump, inner = sshds.start("jump"), sshds.start("inner")
    through(sshds, jump, inner)
    inner.stop()
    with pytest.raises(Unreachable, match=rf"127.0.0.1:{inner.port} cannot be reached from the jump host"):
        connect.connect(inner.robot(address="inner"), config=sshds.config)


def test_a_dead_jump_host_does_not_hold_up_the_end(sshds: Sshds) -> None:
    """Two connections, one inside the other, the outer one frozen in mid-stream."""
    jump, inner = sshds.start("jump"), sshds.start("inner")
    through(sshds, jump, inner)
    with connect.connect(inner.robot(address="inner"), link_timeout=1.5, config=sshds.config) as session:
        threading.Timer(0.5, jump.signal, args=(signal.SIGSTOP,)).start()
        started = time.monotonic()
        with pytest.raises(LinkLost):
            session.run(
                ("sh", "-c", "cat >/dev/null"), feed=(bytes(1 << 20) for _ in range(1 << 20)), limit=None
            )
        session.close()
        assert time.monotonic() - started < 6


def test_a_proxy_command_carries_the_connection_and_ends_with_it(
    sshds: Sshds, sshd: Sshd, tmp_path: Path
) -> None:
    """Its tokens are put in; nothing of it is left running."""
    proxy = f"sh -c 'echo $$ > {tmp_path}/pid; exec /bin/nc %h %p'" if shutil.which("nc") else ""
    proxy = proxy or f"sh -c 'echo $$ > {tmp_path}/pid; exec ssh -q -F {sshds.folder}/plain -W %h:%p gate'"
    (sshds.folder / "plain").write_text(
        f"Host gate\n HostName 127.0.0.1\n Port {sshd.port}\n User {getpass.getuser()}\n IdentityFile {sshd.identity}\n"
        f" UserKnownHostsFile {sshd.known_hosts}\n"
    )
    sshds.configure(f"ProxyCommand {proxy}")
    with connect.connect(sshd.robot(), config=sshds.config) as session:
        assert session.run(("wc", "-c"), feed=[bytes(5 << 20)]).output.strip() == str(5 << 20)
    pid = int((tmp_path / "pid").read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_proxy_command_that_fails_tells_why(sshds: Sshds, sshd: Sshd) -> None:
    """In its own words, at once."""
    sshds.configure("ProxyCommand sh -c 'echo no route to %h >&2; exit 1'")
    started = time.monotonic()
    with pytest.raises(Unreachable, match=r"the ProxyCommand to .* failed: no route to"):
        sshds.log_in(sshd)
    assert time.monotonic() - started < 5
