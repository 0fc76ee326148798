"""A link that is cut again and again: a TCP proxy in this process, in front of a real server."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType

RESET = struct.pack("ii", 1, 0)
"""What `SO_LINGER` takes for closing with an RST."""

PIECE = 32 * 1024


def at_once() -> bool:
    """A cut that waits for nothing."""
    return True


@dataclass(frozen=True, kw_only=True)
class Cut:
    """The end of a connection: after so many bytes to the server, so many seconds later, not before ``when`` is true."""

    after: int
    later: float = 0.0
    when: Callable[[], bool] = at_once


class Cutter:
    """A port of this computer that leads to a server. Each connection is cut by the first of ``todo`` that is left.

    ``rate`` is that of the link to the server, in bytes per second: where the server is the slower one, a cut destroys what
    waits before it. ``sent`` counts the bytes that were given to the server, ``cuts`` the cuts.
    """

    def __init__(self, host: str, port: int, *, rate: float = 1e9) -> None:
        self.todo: Sequence[Cut] = ()
        self.sent = 0
        self.cuts = 0
        self._server = (host, port)
        self._rate = rate
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._counts = threading.Lock()
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listener.getsockname()[1])

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client = self._listener.accept()[0]
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        cut = self.todo[self.cuts] if self.cuts < len(self.todo) else None
        with contextlib.suppress(OSError), client, socket.create_connection(self._server) as server:
            for end in (client, server):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if self._carry(client, server, cut):
                for end in (client, server):
                    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                with self._counts:
                    self.cuts += 1

    def _carry(self, client: socket.socket, server: socket.socket, cut: Cut | None) -> bool:
        """Carry bytes both ways, until an end closes or it is time for the cut: True."""
        count, due = 0, None
        while True:
            if cut and due is None and count >= cut.after and cut.when():
                due = time.monotonic() + cut.later
            if due is not None and time.monotonic() >= due:
                return True
            for end in select.select((client, server), (), (), 0.02)[0]:
                most = max(1, min(PIECE, cut.after - count)) if cut and cut.after > count else PIECE
                data = end.recv(most)
                if not data:
                    return False
                (server if end is client else client).sendall(data)
                if end is client:
                    count += len(data)
                    with self._counts:
                        self.sent += len(data)
                    time.sleep(len(data) / self._rate)
