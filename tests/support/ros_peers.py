"""A ROS master and a node small enough for tests: real sockets, the real protocols, every misbehaviour on request."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast
from xmlrpc.server import SimpleXMLRPCServer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

STRING = "# what std_msgs/String says\nstring data\n"


def packed(*strings: bytes) -> bytes:
    """Length-prefixed fields, as connection headers and ROS strings have them."""
    return b"".join(struct.pack("<I", len(text)) + text for text in strings)


def string_message(text: str) -> bytes:
    return packed(packed(text.encode()))


@contextlib.contextmanager
def serving(act: Callable[[socket.socket], None], host: str = "127.0.0.1") -> Iterator[int]:
    """A TCP server that hands every connection to ``act``; gives its port."""
    with socket.create_server((host, 0)) as listener:

        def accept() -> None:
            with contextlib.suppress(OSError):
                while True:
                    peer, _ = listener.accept()
                    threading.Thread(target=attend, args=(peer,), daemon=True).start()

        def attend(peer: socket.socket) -> None:
            with peer, contextlib.suppress(OSError):
                act(peer)

        threading.Thread(target=accept, daemon=True).start()
        yield listener.getsockname()[1]
        listener.shutdown(socket.SHUT_RDWR)


@contextlib.contextmanager
def answering(methods: dict[str, Callable[..., list[object]]], host: str = "127.0.0.1") -> Iterator[int]:
    """An XML-RPC server; gives its port."""
    with SimpleXMLRPCServer((host, 0), logRequests=False, allow_none=True) as server:
        for name, method in methods.items():
            server.register_function(cast("Any", method), name)
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


@dataclass(kw_only=True)
class Peers:
    """What one master with one publishing node says. Change it to make them misbehave."""

    host: str = "127.0.0.1"
    topic: str = "/time"
    called: str = "127.0.0.1"
    type: str = "std_msgs/String"
    definition: str = STRING
    messages: tuple[bytes, ...] = ()
    hang_up: bool = False
    error: str = ""
    subscribers: list[list[object]] = field(default_factory=list)
    node_port: int = 0
    data_port: int = 0
    master_port: int = 0

    @property
    def master(self) -> str:
        return f"http://127.0.0.1:{self.master_port}"

    @contextlib.contextmanager
    def run(self) -> Iterator[Peers]:
        with (
            serving(self._publish, self.host) as self.data_port,
            answering({"requestTopic": self._request_topic}, self.host) as self.node_port,
            answering(
                {"getSystemState": self._system_state, "lookupNode": self._lookup_node}, self.host
            ) as self.master_port,
        ):
            yield self

    def _system_state(self, _caller: str) -> list[object]:
        return [1, "current system state", [[[self.topic, ["/talker"]]], self.subscribers, []]]

    def _lookup_node(self, _caller: str, node: str) -> list[object]:
        if node != "/talker":
            return [-1, f"unknown node [{node}]", ""]
        return [1, "node api", f"http://{self.called}:{self.node_port}/"]

    def _request_topic(self, _caller: str, topic: str, _protocols: object) -> list[object]:
        if topic != self.topic:
            return [0, f"not a publisher of [{topic}]", 0]
        return [1, "ready", ["TCPROS", self.called, self.data_port]]

    def _publish(self, peer: socket.socket) -> None:
        (count,) = struct.unpack("<I", peer.recv(4))
        asked = peer.recv(count, socket.MSG_WAITALL)
        wrong = b"" if b"md5sum=*" in asked and f"topic={self.topic}".encode() in asked else b"what?"
        lines = [
            f"type={self.type}".encode(),
            b"md5sum=992ce8a1687cec8c8bd883ec73ca41d1",
            f"message_definition={self.definition}".encode(),
        ]
        error = self.error.encode() or wrong
        peer.sendall(packed(packed(*([b"error=" + error] if error else lines))))
        for message in self.messages:
            peer.sendall(message)
        if not self.hang_up:
            peer.recv(1)  # until the listener leaves
