from __future__ import annotations

import socket
import threading

from fleet.images.registry_http import Handler


class _Echo(Handler):
    def do_PUT(self) -> None:  # noqa: N802
        data = b"".join(self.body())
        self.answer(200, {"Content-Length": str(len(data))})
        self.wfile.write(data)


def asked(request: bytes) -> bytes:
    """What one connection answers to some bytes."""
    here, there = socket.socketpair()
    with here, there:
        work = threading.Thread(target=_Echo, args=(there, ("test", 0), None), daemon=True)
        work.start()
        here.sendall(request)
        here.shutdown(socket.SHUT_WR)
        work.join(5)
        there.close()
        return b"".join(iter(lambda: here.recv(1000), b""))


def test_tls_is_answered_in_plain_words() -> None:
    """By that Docker knows that a registry on loopback has none."""
    hello = b"\x16\x03\x01\x00\x05hello"
    assert asked(hello).startswith(b"HTTP/1.0 400")


def test_a_body_in_chunks_and_one_of_known_length() -> None:
    """Docker sends layers whose size it does not know yet."""
    chunked = b"PUT / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n2\r\nde\r\n0\r\n\r\n"
    assert asked(chunked).endswith(b"\r\n\r\nabcde")
    assert asked(b"PUT / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc").endswith(b"\r\n\r\nabc")


def test_a_connection_that_breaks_is_nobodys_error() -> None:
    """In the middle of a body, or before anything was said."""
    assert asked(b"PUT / HTTP/1.1\r\nContent-Length: 30\r\n\r\nabc") == b""
    assert asked(b"") == b""
