from __future__ import annotations

import errno
import socket
import time

import pytest

from fleet.errors import Unreachable
from fleet.ssh import tcp
from tests.support.sshd import free_port

WATCHED = {"KEEPIDLE": 5, "KEEPINTVL": 5, "KEEPCNT": 4, "USER_TIMEOUT": 25_000, "NODELAY": 1}


def connect(host: str, port: int, *, connect_timeout: float = 2, link_timeout: float = 25) -> socket.socket:
    return tcp.connect(host, port, connect_timeout=connect_timeout, link_timeout=link_timeout)


def test_the_socket_watches_its_link() -> None:
    """Idle or under load, the kernel gives up after the link_timeout, not after a quarter of an hour."""
    with socket.create_server(("127.0.0.1", 0)) as server, connect(*server.getsockname()) as sock:
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        options = {
            name: sock.getsockopt(socket.IPPROTO_TCP, getattr(socket, f"TCP_{name}")) for name in WATCHED
        }
    assert options == WATCHED


def test_a_name_with_two_addresses_is_tried_on_both() -> None:
    """localhost is ::1 first, and the server listens on 127.0.0.1 only; mDNS names are like this."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        connect("localhost", server.getsockname()[1]) as sock,
    ):
        assert sock.getpeername() == server.getsockname()


def test_a_refused_connection_is_told() -> None:
    """The robot is there, its sshd is not."""
    port = free_port()
    with pytest.raises(Unreachable, match=f"127.0.0.1 refuses connections to port {port}; check that sshd"):
        connect("127.0.0.1", port)


@pytest.mark.parametrize("name", ["no-such-robot.invalid", "a" * 64, "no..name"])
def test_a_name_that_does_not_resolve_is_told(name: str) -> None:
    """Names that cannot be names, too."""
    with pytest.raises(Unreachable, match=f"the name {name} does not resolve"):
        connect(name, 22)


def test_a_host_that_swallows_everything_is_given_up() -> None:
    """A full queue answers nothing, as a robot that is switched off."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as full:
        waiting = [socket.socket() for _ in range(4)]
        for sock in waiting:
            sock.setblocking(False)
            assert sock.connect_ex(full.getsockname()) in (0, errno.EINPROGRESS)
        started = time.monotonic()
        with pytest.raises(Unreachable, match=r"127.0.0.1 did not answer within 0.5 s"):
            connect("127.0.0.1", full.getsockname()[1], connect_timeout=0.5)
        assert time.monotonic() - started < 2
        for sock in waiting:
            sock.close()


def test_a_network_without_a_way_there_is_told() -> None:
    """The kernel's own reason, in words."""
    with pytest.raises(Unreachable, match=r"cannot be reached: [A-Z]"):
        connect("255.255.255.255", 22)
