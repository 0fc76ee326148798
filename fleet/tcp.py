"""How is a TCP connection made that notices when the other end is gone?"""

from __future__ import annotations

import contextlib
import socket

from fleet.errors import Unreachable


def connect(host: str, port: int, *, patience: float, silence: float) -> socket.socket:
    """A connected socket. ``patience`` is in seconds, for the connection; ``silence`` for bytes nobody acknowledges.

    Raises:
        Unreachable: with the reason in words.

    """
    try:
        sock = socket.create_connection((host, port), timeout=patience)
    except socket.gaierror as problem:
        cure = "is it on this network? try its IP address, or avahi-daemon on the robot for .local names"
        raise Unreachable(f"the name {host} does not resolve", cure=cure) from problem
    except ConnectionRefusedError as problem:
        raise Unreachable(
            f"{host} refuses connections to port {port}", cure="is sshd running there?"
        ) from problem
    except TimeoutError as problem:
        what = f"{host} does not answer within {patience:g} s"
        raise Unreachable(what, cure="does it have power and Wi-Fi?") from problem
    except OSError as problem:
        what = f"{host} cannot be reached: {problem.strerror or problem}"
        raise Unreachable(what, cure="does it have power and Wi-Fi?") from problem
    _watch(sock, silence=silence)
    return sock


def _watch(sock: socket.socket, *, silence: float) -> None:
    """Keepalive for an idle link, ``TCP_USER_TIMEOUT`` for one under load; see tcp(7)."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    every = max(1, int(silence // 5))
    wanted = {
        "TCP_KEEPIDLE": every,
        "TCP_KEEPINTVL": every,
        "TCP_KEEPCNT": 4,
        "TCP_NODELAY": 1,
        "TCP_USER_TIMEOUT": int(silence * 1000),
    }
    for option, value in wanted.items():
        if hasattr(socket, option):  # macOS lacks some
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    with contextlib.suppress(
        OSError, AttributeError
    ):  # worth twice the throughput at 1 % loss, where it is allowed
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, b"bbr")
