"""A ROS 2 publisher small enough for tests: real sockets, its own writing of RTPS, misbehaviour on request."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import threading
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

ANNOUNCER, PUBLICATIONS, SUBSCRIPTIONS = b"\0\1\0\xc2", b"\0\0\3\xc2", b"\0\0\4\xc2"
WRITER = b"\0\0\1\3"
END = struct.pack("<HH", 1, 0)


def submessage(kind: int, body: bytes, flags: int = 1) -> bytes:
    return struct.pack("<BBH", kind, flags, len(body)) + body


def parameter(name: int, value: bytes) -> bytes:
    value += bytes(-len(value) % 4)
    return struct.pack("<HH", name, len(value)) + value


def string(text: str) -> bytes:
    return struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def locator(host: str, port: int) -> bytes:
    return struct.pack("<iI", 1, port) + bytes(12) + socket.inet_aton(host)


def string_message(text: str) -> bytes:
    """A std_msgs/String."""
    return b"\0\1\0\0" + string(text)


def datagram(prefix: bytes, *parts: bytes) -> bytes:
    return b"RTPS\2\3\1\x0f" + prefix + b"".join(parts)


def data(writer: bytes, number: int, payload: bytes) -> bytes:
    return submessage(
        0x15, b"\0\0\x10\0" + bytes(4) + writer + struct.pack("<iI", 0, number) + payload, 1 | 4
    )


def gone(writer: bytes, number: int, guid: bytes) -> bytes:
    quality = parameter(0x70, guid) + parameter(0x71, b"\0\0\0\3") + END
    return submessage(
        0x15, b"\0\0\x10\0" + bytes(4) + writer + struct.pack("<iI", 0, number) + quality, 1 | 2 | 8
    )


def fragments(writer: bytes, number: int, payload: bytes, size: int) -> list[bytes]:
    """A message in pieces of ``size`` bytes."""
    return [
        submessage(
            0x16,
            b"\0\0\x1c\0" + bytes(4) + writer
            + struct.pack("<iIIHHI", 0, number, at // size + 1, 1, size, len(payload))
            + payload[at : at + size],
        )
        for at in range(0, len(payload), size)
    ]  # fmt: skip


def asks(raw: bytes, writer: bytes) -> bool:
    """Whether a datagram has an acknack to ``writer`` that wants an answer: one that is not final (RTPS 2.5, 9.4.5.3)."""
    at = 20
    while at + 4 <= len(raw):
        kind, flags, length = struct.unpack_from("<BBH", raw, at)
        if kind == 0x06 and not flags & 2 and raw[at + 8 : at + 12] == writer:
            return True
        at += 4 + length
    return False


def heartbeat(writer: bytes, first: int, last: int, *, final: bool = False) -> bytes:
    return submessage(
        0x07, bytes(4) + writer + struct.pack("<iIiII", 0, first, 0, last, 1), 3 if final else 1
    )


def announcement(prefix: bytes, place: tuple[str, int], *, domain: int = 0, extra: bytes = b"") -> bytes:
    said = parameter(0x50, prefix + b"\0\0\1\xc1") + parameter(0x0F, struct.pack("<I", domain))
    said += parameter(0x02, struct.pack("<iI", 20, 0)) + parameter(0x16, b"\1\x0f")
    said += parameter(0x32, locator(*place)) + parameter(0x31, locator(*place)) + extra
    return datagram(prefix, data(ANNOUNCER, 1, b"\0\3\0\0" + said + END))


def publication(
    prefix: bytes, number: int, topic: str, kind: str = "std_msgs::msg::dds_::String_", *, durable: bool = False,
    reliable: bool = True, writer: bytes = WRITER,
) -> bytes:  # fmt: skip
    said = parameter(0x5A, prefix + writer) + parameter(0x05, string(topic)) + parameter(0x07, string(kind))
    said += parameter(0x1A, struct.pack("<IiI", 2 if reliable else 1, 0, 0)) + parameter(
        0x1D, struct.pack("<I", int(durable))
    )
    return data(PUBLICATIONS, number, b"\0\3\0\0" + said + END)


@dataclass(kw_only=True)
class Peer:
    """A participant at 127.0.0.1 with one publisher. Change it to make it misbehave."""

    domain: int
    topic: str = "/chatter"
    kind: str = "std_msgs::msg::dds_::String_"
    messages: list[bytes] = field(default_factory=lambda: [string_message("noon"), string_message("later")])
    answers: bool = True
    """It answers those who find it."""
    accepts: bool = True
    """It takes note of subscriptions."""
    secured: bool = False
    piece: int = 0
    """Bytes of each fragment, 0 for whole messages."""
    lost: int = 0
    """Each fragment with a number that this one divides is lost."""
    prefix: bytes = field(default_factory=lambda: b"\1\x0f" + os.urandom(10))
    heard: list[bytes] = field(default_factory=list)

    @contextlib.contextmanager
    def run(self) -> Iterator[Peer]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as self._socket:
            self._socket.bind(("127.0.0.1", 7400 + 250 * self.domain + 10))
            self._socket.settimeout(0.02)
            self._ended = threading.Event()
            self._subscriber: tuple[str, int] | None = None
            self._sent = 0
            thread = threading.Thread(target=self._serve)
            thread.start()
            yield self
            self._ended.set()
            thread.join()

    def _serve(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            with contextlib.suppress(TimeoutError):
                raw, source = self._socket.recvfrom(65536)
                self.heard.append(raw)
                self._answer(raw, source)
            if self._subscriber and self._sent < len(self.messages) and time.monotonic() > due:
                due = time.monotonic() + 0.05
                self._publish(self._subscriber)

    def _answer(self, raw: bytes, source: tuple[str, int]) -> None:
        send = self._socket.sendto
        if ANNOUNCER in raw[:44]:
            extra = parameter(0x1001, bytes(8)) if self.secured else b""
            send(
                announcement(self.prefix, self._socket.getsockname(), domain=self.domain, extra=extra), source
            )
        if not self.answers:
            return
        if asks(raw, PUBLICATIONS):
            found = publication(self.prefix, 1, f"rt{self.topic}", self.kind)
            send(datagram(self.prefix, found, heartbeat(PUBLICATIONS, 1, 1)), source)
        if SUBSCRIPTIONS in raw and self.accepts:
            self._subscriber = source
            numbers = struct.pack("<iII", 0, 2, 0) + struct.pack("<I", 1)
            acknack = submessage(0x06, b"\0\0\4\xc7" + SUBSCRIPTIONS + numbers)
            send(datagram(self.prefix, acknack), source)

    def _publish(self, to: tuple[str, int]) -> None:
        message = self.messages[self._sent]
        self._sent += 1
        pieces = (
            fragments(WRITER, self._sent, message, self.piece)
            if self.piece
            else [data(WRITER, self._sent, message)]
        )
        for number, piece in enumerate(pieces, start=1):
            if not self.lost or number % self.lost:
                self._socket.sendto(datagram(self.prefix, piece), to)
