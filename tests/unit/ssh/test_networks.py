from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError, LinkLost, LoginRefused, Unreachable
from fleet.ssh import connect
from tests.support.link_cutter import Cut, Cutter
from tests.support.sshd import free_port, make_key

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.sshd import Sshd, Sshds


def test_a_port_without_sshd_is_told(sshds: Sshds, sshd: Sshd) -> None:
    """A connection refused is not retried."""
    sshd.stop()
    with pytest.raises(Unreachable, match=f"127.0.0.1 refuses connections to port {sshd.port}"):
        sshds.log_in(sshd)


@pytest.mark.parametrize("accepts", [True, False])
def test_a_port_that_says_nothing_is_given_up(sshds: Sshds, sshd: Sshd, *, accepts: bool) -> None:
    """A robot whose kernel lives and whose sshd does not."""
    with socket.create_server(("127.0.0.1", 0)) as silent, contextlib.ExitStack() as accepted:
        port = silent.getsockname()[1]
        if accepts:
            threading.Thread(target=lambda: accepted.enter_context(silent.accept()[0]), daemon=True).start()
        robot = sshd.robot().model_copy(update={"port": port})
        started = time.monotonic()
        with pytest.raises(
            Unreachable, match=f"127.0.0.1:{port} accepts the connection but sends no SSH banner"
        ):
            connect.connect(robot, connect_timeout=0.5, config=sshds.config)
        assert time.monotonic() - started < 3


def test_a_frozen_sshd_is_given_up(sshds: Sshds, sshd: Sshd) -> None:
    """No connection is ever waited for without end."""
    sshd.signal(signal.SIGSTOP)
    with pytest.raises(Unreachable, match="sends no SSH banner"):
        connect.connect(sshd.robot(), connect_timeout=0.5, config=sshds.config)


@contextlib.contextmanager
def answering(text: bytes, *, then_wait: bool) -> Iterator[tuple[int, list[int]]]:
    """A server that says one thing to everybody: its port, and a number for everybody it served."""
    server = socket.create_server(("127.0.0.1", 0))
    served: list[int] = []

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                with server.accept()[0] as client:
                    served.append(1)
                    client.sendall(text)
                    while then_wait and client.recv(1 << 20):
                        pass

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield server.getsockname()[1], served
    finally:
        server.shutdown(socket.SHUT_RDWR)
        server.close()
        thread.join()


def test_a_key_exchange_that_stops_is_given_up(sshds: Sshds, sshd: Sshd) -> None:
    """A robot so busy that it does not get past its banner."""
    with answering(b"SSH-2.0-OpenSSH_9.2\r\n", then_wait=True) as (port, _):
        robot = sshd.robot().model_copy(update={"port": port})
        with pytest.raises(Unreachable, match="stopped answering during the key exchange"):
            connect.connect(robot, connect_timeout=0.5, config=sshds.config)


def test_a_server_of_another_kind_is_told(sshds: Sshds, sshd: Sshd) -> None:
    """What it says is no key exchange."""
    with answering(b"SSH-2.0-x\r\nHTTP/1.1 400 Bad Request\r\n\r\n", then_wait=False) as (port, served):
        with pytest.raises(Unreachable, match="broke off the key exchange"):
            connect.connect(sshd.robot().model_copy(update={"port": port}), config=sshds.config)
        assert len(served) == 1


def test_a_server_that_hangs_up_is_tried_again(sshds: Sshds, sshd: Sshd) -> None:
    """MaxStartups looks like this; so do a blocked address and a wrong port, as the message says in the end."""
    with answering(b"", then_wait=False) as (port, served):
        with pytest.raises(Unreachable, match=r"closed the connection, or is not an SSH server.*MaxStartups"):
            connect.connect(
                sshd.robot().model_copy(update={"port": port}), connect_timeout=0.5, config=sshds.config
            )
        assert len(served) == connect.ATTEMPTS


def test_an_sshd_that_is_busy_with_logins_is_tried_again(sshds: Sshds) -> None:
    """Many robots behind one gate: beyond MaxStartups it drops whoever comes, until others are through."""
    server = sshds.start(options=("MaxStartups 2:100:2", "LogLevel VERBOSE"))
    with contextlib.ExitStack() as others:
        for _ in range(2):
            other = others.enter_context(socket.create_connection(("127.0.0.1", server.port)))
            assert other.recv(4) == b"SSH-"
        threading.Timer(0.6, others.close).start()
        assert sshds.log_in(server) == "in\n"
    assert "MaxStartups" in server.log.read_text()


def test_a_link_that_is_lost_is_never_taken_for_a_refusal(sshds: Sshds, sshd: Sshd) -> None:
    """Wherever it is cut, in the login or later: such a robot is worth trying again."""
    with Cutter("127.0.0.1", sshd.port) as link:
        server = replace(sshd, port=link.port)
        server.trust()
        link.todo = [Cut(after=after) for after in range(1300, 4300, 150)]
        while link.cuts < len(link.todo):
            with (
                pytest.raises((Unreachable, LinkLost)),
                connect.connect(server.robot(), connect_timeout=1, config=sshds.config) as session,
            ):
                session.run(("cat",), feed=(bytes(4000),))


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_nothing_of_a_failed_login_stays(sshds: Sshds, sshd: Sshd) -> None:
    """Two hundred robots that refuse us must not use up this computer's files and threads."""
    key = make_key(sshds.folder / "wrong")

    def refused() -> None:
        with pytest.raises(LoginRefused):
            sshds.log_in(sshd, identity=key)

    refused()
    files, threads = open_files(), threading.active_count()
    for _ in range(5):
        refused()
    deadline = time.monotonic() + 5
    while threading.active_count() > threads and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() <= threads
    assert open_files() <= files


def test_without_openssh_the_cure_is_told(sshds: Sshds, sshd: Sshd, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is what reads the configuration."""
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(DesktopError, match="install openssh-client"):
        sshds.log_in(sshd)


@dataclass(frozen=True, kw_only=True)
class Cable:
    """A virtual cable to a network namespace, where ``address`` is."""

    namespace: str
    address: str

    def cut(self) -> None:
        """Packets vanish, and nobody is told."""
        for command in (f"address flush to {self.address}", "route flush table main"):
            subprocess.run(("ip", "-n", self.namespace, *command.split()), check=True)


@pytest.fixture
def cable() -> Iterator[Cable]:
    if os.geteuid() != 0 or not shutil.which("ip"):
        pytest.skip("network namespaces need root and iproute2")
    number = os.getpid()
    name, near, net = f"fleet{number}", f"fl{number}", f"10.213.{number % 256}"
    commands = (
        f"ip netns add {name}",
        f"ip link add {near} type veth peer name eth0 netns {name}",
        f"ip address add {net}.1/30 dev {near}",
        f"ip link set {near} up",
        f"ip -n {name} address add {net}.2/30 dev eth0",
        f"ip -n {name} link set eth0 up",
        f"ip -n {name} link set lo up",
    )
    try:
        for command in commands:
            subprocess.run(command.split(), check=True)
        yield Cable(namespace=name, address=f"{net}.2")
    finally:
        subprocess.run(("ip", "link", "delete", near), check=False)
        subprocess.run(("ip", "netns", "delete", name), check=False)


@pytest.mark.parametrize("feeding", [False, True])
def test_a_cut_cable_is_noticed(sshds: Sshds, cable: Cable, *, feeding: bool) -> None:
    """In mid-command and in mid-stream; the next command does not hang either, nor the next connection."""
    server = sshds.start(address=cable.address, within=("ip", "netns", "exec", cable.namespace))
    feed = (bytes(1 << 20) for _ in range(1 << 20)) if feeding else None
    with connect.connect(server.robot(), link_timeout=2, config=sshds.config) as session:
        threading.Timer(0.5, cable.cut).start()
        started = time.monotonic()
        with pytest.raises(LinkLost):
            session.run(("sh", "-c", "cat >/dev/null"), feed=feed, limit=None)
        with pytest.raises(LinkLost):
            session.run(("true",))
        assert time.monotonic() - started < 8
    with pytest.raises(Unreachable, match=r"did not answer within 1 s|cannot be reached"):
        connect.connect(server.robot(), connect_timeout=1, config=sshds.config)


def test_a_cut_cable_to_a_jump_host_is_noticed(sshds: Sshds, cable: Cable) -> None:
    """In mid-stream the inner connection cannot even say goodbye: what is queued outside stands in its way."""
    within = ("ip", "netns", "exec", cable.namespace)
    jump = sshds.start("jump", address=cable.address, within=within)
    inner = sshds.start("inner", within=within)
    sshds.configure(f"Host 127.0.0.1\n  ProxyJump {cable.address}\nHost *\n  IdentityFile {jump.identity}")
    with connect.connect(inner.robot(), link_timeout=2, config=sshds.config) as session:
        threading.Timer(0.5, cable.cut).start()
        started = time.monotonic()
        with pytest.raises(LinkLost):
            session.run(
                ("sh", "-c", "cat >/dev/null"), feed=(bytes(1 << 20) for _ in range(1 << 20)), limit=None
            )
        session.close()
        assert time.monotonic() - started < 8


def test_a_free_port_is_no_robot(sshds: Sshds, sshd: Sshd) -> None:
    """`offered_key` fails as `connect` does."""
    with pytest.raises(Unreachable, match="refuses connections"):
        connect.offered_key(sshd.robot().model_copy(update={"port": free_port()}), config=sshds.config)
