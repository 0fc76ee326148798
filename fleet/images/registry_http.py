"""How does a registry of ours talk HTTP with Docker, which tries TLS first? What `push` and `fleet.transfer.pull_server` share.

The protocol is that of opencontainers/distribution-spec. Docker uses it without TLS for 127.0.0.0/8.
"""

from __future__ import annotations

import contextlib
import http.server
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_CHUNK = 1 << 20
_TLS_HANDSHAKE = b"\x16"  # how a TLS record begins that opens a connection: Docker tries that first
_TLS_HEADER = 5  # bytes of a record before its content; the last two are the length (RFC 8446, section 5.1)


class Handler(http.server.BaseHTTPRequestHandler):
    """One connection of Docker's. A connection that breaks is Docker's business: it tries again."""

    protocol_version = "HTTP/1.1"
    timeout = 60.0  # seconds of silence

    def handle_one_request(self) -> None:
        """See ``http.server``. TLS is answered as Go's servers do: by that Docker knows that it has to go on without."""
        with contextlib.suppress(OSError):
            if self.rfile.peek(1)[:1] != _TLS_HANDSHAKE:  # type: ignore[attr-defined]  # a BufferedReader
                super().handle_one_request()
                return
            self.rfile.read(int.from_bytes(self.rfile.read(_TLS_HEADER)[-2:]))
            self.wfile.write(b"HTTP/1.0 400 Bad Request\r\n\r\nThis is HTTP.\n")
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def drain(self) -> None:
        """Read a request's body and forget it."""
        for _ in self.body():
            pass

    def body(self) -> Iterable[bytes]:
        """The chunks of a request's body (RFC 9112, sections 6 and 7.1)."""
        if self.headers.get("Transfer-Encoding", "").lower() != "chunked":
            yield from self._bytes(int(self.headers.get("Content-Length") or 0))
            return
        while size := int(self.rfile.readline(100).partition(b";")[0], 16):
            yield from self._bytes(size)
            self.rfile.readline(100)
        while self.rfile.readline(1000).strip():
            pass

    def _bytes(self, size: int) -> Iterable[bytes]:
        while size:
            chunk = self.rfile.read(min(size, _CHUNK))
            if not chunk:
                raise OSError("the connection ended within a body")
            size -= len(chunk)
            yield chunk

    def answer(self, code: int, headers: Mapping[str, str] | None = None) -> None:
        """Send the head of an answer. Without a Content-Length among ``headers`` it has no body."""
        self.send_response(code)
        all_headers = {
            "Content-Length": "0",
            "Docker-Distribution-Api-Version": "registry/2.0",
            **(headers or {}),
        }
        for name, value in all_headers.items():
            self.send_header(name, value)
        self.end_headers()
