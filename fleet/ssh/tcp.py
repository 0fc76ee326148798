"""How is a TCP connection opened that notices when the other end is gone?"""

from __future__ import annotations

import contextlib
import socket
import time

from fleet.errors import Unreachable

_POWER = "check that it has power, and that this computer is on the same network"
_UNSENT = 256 * 1024


def connect(host: str, port: int, *, connect_timeout: float, link_timeout: float) -> socket.socket:
    """Return a connected socket.

    ``connect_timeout`` is in seconds and covers all addresses of ``host``; ``link_timeout`` is in seconds, and how long bytes may
    stay unacknowledged before the kernel closes the connection.

    Raises:
        Unreachable: with the reason in words.

    """
    sock = _open(host, port, connect_timeout=connect_timeout)
    sock.settimeout(None)
    _set_timeouts(sock, link_timeout=link_timeout)
    return sock


def _open(host: str, port: int, *, connect_timeout: float) -> socket.socket:
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (socket.gaierror, UnicodeError) as problem:
        cure = "check that it is on this network, or use its IP address (.local names need avahi-daemon on the robot)"
        raise Unreachable(f"the name {host} does not resolve", cure=cure) from problem
    deadline = time.monotonic() + connect_timeout
    for left, (family, kind, protocol, _, address) in zip(
        range(len(addresses), 0, -1), addresses, strict=True
    ):
        sock = socket.socket(family, kind, protocol)
        # An address that never answers (often IPv6) must leave time for the next one.
        sock.settimeout(max(0.1, (deadline - time.monotonic()) / left))
        try:
            sock.connect(address)
        except OSError as problem:
            sock.close()
            if left == 1:
                raise _explained(problem, host=host, port=port, connect_timeout=connect_timeout) from problem
        else:
            return sock
    raise AssertionError("getaddrinfo never answers with nothing")


def _explained(problem: OSError, *, host: str, port: int, connect_timeout: float) -> Unreachable:
    match problem:
        case ConnectionRefusedError():
            return Unreachable(
                f"{host} refuses connections to port {port}",
                cure="check that sshd runs there, and on this port",
            )
        case TimeoutError():
            return Unreachable(f"{host} did not answer within {connect_timeout:g} s", cure=_POWER)
        case _:
            return Unreachable(f"{host} cannot be reached: {problem.strerror or problem}", cure=_POWER)


def _set_timeouts(sock: socket.socket, *, link_timeout: float) -> None:
    """Keepalive for an idle link, ``TCP_USER_TIMEOUT`` for one under load; see tcp(7)."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    every = max(1, int(link_timeout // 5))
    wanted = {
        "TCP_KEEPIDLE": every,
        "TCP_KEEPINTVL": every,
        "TCP_KEEPCNT": 4,
        "TCP_NODELAY": 1,
        "TCP_USER_TIMEOUT": int(link_timeout * 1000),
        # Megabytes queued in the kernel would count as sent, and delay signs of life on a slow link.
        "TCP_NOTSENT_LOWAT": _UNSENT,
    }
    for option, value in wanted.items():
        if hasattr(socket, option):  # macOS lacks some
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    # BBR doubles the throughput at 1 % packet loss, if the kernel has it and allows it.
    with contextlib.suppress(OSError, AttributeError):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, b"bbr")
