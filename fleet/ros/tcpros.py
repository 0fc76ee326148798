"""How does a ROS 1 graph look from outside, without ROS? Its master, its nodes, and one topic's bytes.

A listener asks the master who publishes a topic, the publishing node where its data comes out, and reads there. It
does not register, so the graph does not change. https://wiki.ros.org/ROS/Master_API, https://wiki.ros.org/ROS/Slave_API
and https://wiki.ros.org/ROS/TCPROS describe the three conversations.

Standard library only, and good for Python 3.8: the image carries this file as its health check, which is healthy when
one real message was read::

    python3 tcpros.py /time --timeout 5

With ``--all``, it prints each message as a line of JSON, until its input ends: so `fab listen --via robot` hears a topic.
Then the codes `CANNOT` and `UNPUBLISHED` mean that another container may hear it.
Everything has a time limit: a ``deadline`` is a time of `time.monotonic`, in seconds.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import errno
import json
import os
import select
import socket
import struct
import sys
import threading
import time
import xmlrpc.client
from typing import TYPE_CHECKING, Any, NamedTuple, cast
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError

if TYPE_CHECKING:
    from collections.abc import Iterator

CALLER = "/fleet_listener"
LARGEST_ANSWER = 8 << 20  # bytes; a graph of fifty thousand topics, by far the largest message definition
LARGEST_MESSAGE = 256 << 20  # bytes; more than any camera or laser sends
LONGEST_REASON = 500  # characters of an error: some of them are a peer's own words
SIGN_OF_LIFE = 45.0  # a desktop that listens sends a byte every ten seconds
CANNOT, UNPUBLISHED = (
    3,
    4,
)  # exit codes: the master or the publisher cannot be reached from here; nobody publishes the topic


class GraphError(Exception):
    """A step on the way to a message failed."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason if len(reason) <= LONGEST_REASON else reason[:LONGEST_REASON] + " ...")


class NameUnknown(GraphError):
    """A host name does not resolve on this computer."""


class NoConnection(GraphError):
    """A host and port accept no connection; ``reason`` is the system's, such as "Connection refused"."""

    def __init__(self, host: str, port: int, reason: str) -> None:
        super().__init__(f"no connection to {host} port {port}: {reason}")
        self.reason, self.refused = reason, reason == os.strerror(errno.ECONNREFUSED)


class Silent(GraphError):
    """A connected peer did not answer in time."""


class Closed(GraphError):
    """A peer closed the connection."""


class Refused(GraphError):
    """A master or node answered, and its answer is no, or makes no sense."""


class NotPublished(GraphError):
    """The master knows nobody who publishes the topic."""


def addresses(host: str, port: int, deadline: float) -> list[tuple[Any, ...]]:
    """Return the `socket.getaddrinfo` rows of a host, IPv4 first: ROS 1 listens on nothing else unless told to.

    A resolver has no time limit of its own, so it waits in a thread. Raises `NameUnknown`.
    """
    found: list[tuple[Any, ...]] = []

    def resolve() -> None:
        with contextlib.suppress(OSError, ValueError):  # a name that cannot be one is a ValueError
            found.extend(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))

    asking = threading.Thread(target=resolve, daemon=True)
    asking.start()
    asking.join(max(0.0, deadline - time.monotonic()))
    rows = sorted(found, key=lambda row: row[0] != socket.AF_INET)
    if not rows:
        raise NameUnknown(f"the name {host} does not resolve here")
    return rows


class Wire:
    """One TCP connection, every use of which ends by a deadline."""

    def __init__(self, host: str, port: int, deadline: float) -> None:
        """Connect. Raises `NameUnknown` or `NoConnection`."""
        self.peer = f"{host} port {port}"
        self._socket = self._connect(host, port, deadline)

    @staticmethod
    def _connect(host: str, port: int, deadline: float) -> socket.socket:
        rows = addresses(host, port, deadline)
        problems = []
        for left, (family, kind, protocol, _, address) in zip(range(len(rows), 0, -1), rows):  # noqa: B905 - 3.8
            connection = socket.socket(family, kind, protocol)
            connection.settimeout(max(0.05, (deadline - time.monotonic()) / left))
            try:
                connection.connect(address)
            except OSError as error:
                connection.close()
                problems.append(error.strerror or "no answer")
            else:
                return connection
        raise NoConnection(host, port, problems[0])

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def send(self, data: bytes, deadline: float) -> None:
        """Send all of it. Raises `Silent` or `Closed`."""
        self._within(deadline, lambda: self._socket.sendall(data))

    def read(self, count: int, deadline: float) -> bytes:
        """Return exactly so many bytes. Raises `Silent` or `Closed`."""
        data = bytearray()
        while len(data) < count:
            piece = self._some(min(count - len(data), 1 << 16), deadline)
            if not piece:
                raise Closed(f"{self.peer} closed the connection")
            data += piece
        return bytes(data)

    def read_to_end(self, most: int, deadline: float) -> bytes:
        """Return all until the peer closes, cut off at so many bytes. Raises `Silent` or `Closed`."""
        data = bytearray()
        while len(data) < most and (piece := self._some(1 << 16, deadline)):
            data += piece
        return bytes(data)

    def _some(self, most: int, deadline: float) -> bytes:
        return bytes(self._within(deadline, lambda: self._socket.recv(most)))

    def _within(self, deadline: float, act: Any) -> Any:  # noqa: ANN401 - sendall's None or recv's bytes
        self._socket.settimeout(max(0.001, deadline - time.monotonic()))
        try:
            return act()
        except socket.timeout:  # noqa: UP041 - the same class only since Python 3.10
            raise Silent(f"{self.peer} is connected and says nothing") from None
        except OSError as problem:
            raise Closed(f"{self.peer} ended the connection: {problem.strerror or problem}") from problem


def address_of(uri: str) -> tuple[str, int]:
    """Return host and port of a master's or node's URI, ``http://HOST:PORT/``. Raises `Refused`."""
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port:
        raise Refused(f"{uri!r} is not a URI of the form http://HOST:PORT")
    return host, port


def call(uri: str, method: str, *arguments: Any, deadline: float) -> Any:  # noqa: ANN401 - XML-RPC carries any
    """Call a method of the Master or Slave API and return its value. Raises `GraphError`.

    `xmlrpc.client`'s own connection has a time limit for each packet only; a peer that drips bytes would hold it.
    """
    host, port = address_of(uri)
    body = xmlrpc.client.dumps((CALLER, *arguments), method).encode()
    head = f"POST / HTTP/1.0\r\nHost: {host}:{port}\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
    with contextlib.closing(Wire(host, port, deadline)) as wire:
        wire.send(head.encode() + body, deadline)
        answer = wire.read_to_end(LARGEST_ANSWER, deadline)
    try:
        (result,), _ = xmlrpc.client.loads(answer.partition(b"\r\n\r\n")[2])
        code, status, value = cast("list[Any]", result)
    except xmlrpc.client.Fault as fault:
        raise Refused(f"{uri} answers {method} with: {fault.faultString}") from fault
    except (xmlrpc.client.Error, ExpatError, ValueError, TypeError, LookupError) as problem:
        raise Refused(f"{uri} does not speak ROS: its answer to {method} makes no sense") from problem
    if code != 1:
        raise Refused(f"{uri} answers {method} with: {status}")
    return value


class Graph(NamedTuple):
    """The nodes that publish and subscribe to each topic, as the master lists them."""

    publishers: dict[str, list[str]]
    subscribers: dict[str, list[str]]


def graph(master: str, *, deadline: float) -> Graph:
    """Ask the master (a URI) for its ``getSystemState``."""
    state = call(master, "getSystemState", deadline=deadline)
    try:
        return Graph(*({str(t): [str(n) for n in nodes] for t, nodes in part} for part in state[:2]))
    except (TypeError, ValueError, LookupError) as problem:
        raise Refused(f"{master} is not a ROS master: its getSystemState makes no sense") from problem


def node_uri(master: str, node: str, *, deadline: float) -> str:
    """Ask the master for the URI a node registered with, ``http://ITS_ROS_HOSTNAME:PORT/`` (``lookupNode``)."""
    return str(call(master, "lookupNode", node, deadline=deadline))


def data_address(node: str, topic: str, *, deadline: float) -> tuple[str, int]:
    """Ask a node (a URI) for the host and port of a topic's bytes (``requestTopic``)."""
    answer = call(node, "requestTopic", topic, [["TCPROS"]], deadline=deadline)
    if isinstance(answer, list) and len(answer) == 3 and answer[0] == "TCPROS" and isinstance(answer[2], int):
        host, port = str(answer[1]), int(answer[2])
        if host and 0 < port < 65536:
            return host, port
    raise Refused(f"{node} offers {topic} in no form that can be read here: {answer!r}")


class Stream:
    """The messages of one publisher of one topic."""

    def __init__(self, host: str, port: int, topic: str, *, deadline: float) -> None:
        """Connect, and exchange connection headers: any type is welcome. Raises `GraphError`."""
        self._wire = Wire(host, port, deadline)
        asked = {"callerid": CALLER, "topic": topic, "type": "*", "md5sum": "*", "tcp_nodelay": "1"}
        try:
            self._wire.send(_packed(asked), deadline)
            header = _unpacked(self._wire.read(_length(self._wire, LARGEST_ANSWER, deadline), deadline))
            if "error" in header:
                raise Refused(f"{self._wire.peer} refuses a subscriber of {topic}: {header['error']}")
        except GraphError:
            self.close()
            raise
        self.type = header.get("type", "")
        self.definition = header.get("message_definition", "")

    def read(self, timeout: float) -> bytes:
        """Return the next message as it was sent, within ``timeout`` seconds. Raises `Silent` or `Closed`."""
        count = _length(self._wire, LARGEST_MESSAGE, time.monotonic() + timeout)
        return self._wire.read(count, time.monotonic() + timeout)

    def close(self) -> None:
        """Leave."""
        self._wire.close()


def _length(wire: Wire, most: int, deadline: float) -> int:
    (count,) = struct.unpack("<I", wire.read(4, deadline))
    if count > most:
        raise Refused(f"{wire.peer} does not speak TCPROS: it announces {count} bytes")
    return int(count)


def _packed(fields: dict[str, str]) -> bytes:
    """Write a connection header: https://wiki.ros.org/ROS/Connection%20Header."""
    lines = [f"{name}={value}".encode() for name, value in fields.items()]
    body = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    return struct.pack("<I", len(body)) + body


def _unpacked(body: bytes) -> dict[str, str]:
    fields = {}
    while len(body) >= 4:
        (count,) = struct.unpack_from("<I", body)
        name, _, value = body[4 : 4 + count].decode(errors="replace").partition("=")
        fields[name], body = value, body[4 + count :]
    return fields


def resolved(topic: str, namespace: str) -> str:
    """Return a topic's full name: a relative one follows the namespace, as a node's own would."""
    return topic if topic.startswith("/") else "/" + "/".join(p for p in (namespace.strip("/"), topic) if p)


def first_message(master: str, topic: str, *, deadline: float) -> bytes:
    """Read one message from whoever publishes the topic. Raises `GraphError`, the last publisher's."""
    return next(messages(master, topic, deadline=deadline))[1]


def messages(
    master: str, topic: str, *, deadline: float, timeout: float = 0.0
) -> Iterator[tuple[Stream, bytes]]:
    """Yield the messages of the first publisher that sends one. The later ones have ``timeout`` seconds each.

    Ends only by raising `GraphError`: the last publisher's, or that of the one that sent messages.
    """
    problem: GraphError = NotPublished(f"nobody publishes {topic} at {master}")
    for node in graph(master, deadline=deadline).publishers.get(topic, []):
        came = False
        try:
            host, port = data_address(node_uri(master, node, deadline=deadline), topic, deadline=deadline)
            with contextlib.closing(Stream(host, port, topic, deadline=deadline)) as stream:
                while True:
                    data = stream.read(timeout if came else max(0.0, deadline - time.monotonic()))
                    came = True
                    yield stream, data
        except GraphError as error:
            problem = error
            if came:
                break
    raise problem


def show(stream: Stream, data: bytes) -> None:
    """Print a message as a line of JSON."""
    line = {"type": stream.type, "definition": stream.definition}
    clocks = {"at": time.time(), "monotonic": time.monotonic()}
    sys.stdout.write(json.dumps({**line, **clocks, "data": base64.b64encode(data).decode()}) + "\n")
    sys.stdout.flush()


def end_with_input() -> None:
    """End this program as soon as its input ends or falls silent, as when the connection to the desktop is lost."""

    def watch() -> None:
        while select.select([0], [], [], SIGN_OF_LIFE)[0] and os.read(0, 1):
            pass
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


def main() -> int:
    """Read one message, as the container's health check: 0 when it came, otherwise the reason and 1, or `_code`."""
    options = argparse.ArgumentParser(description="Read one message of a ROS 1 topic.")
    options.add_argument("topic", help="a relative name follows ROS_NAMESPACE")
    options.add_argument("--master", default=os.environ.get("ROS_MASTER_URI", "http://localhost:11311"))
    options.add_argument("--timeout", type=float, default=5.0, metavar="SECONDS")
    options.add_argument("--all", action="store_true", help="print all messages, until standard input ends")
    asked = options.parse_args()
    topic = resolved(asked.topic, os.environ.get("ROS_NAMESPACE", ""))
    deadline = time.monotonic() + asked.timeout
    try:
        if asked.all:
            end_with_input()
            for stream, data in messages(asked.master, topic, deadline=deadline, timeout=asked.timeout):
                show(stream, data)
        first_message(asked.master, topic, deadline=deadline)
    except GraphError as problem:
        sys.stdout.write(f"{topic}: {problem}\n")
        return _code(problem) if asked.all else 1
    return 0


def _code(problem: GraphError) -> int:
    if isinstance(problem, NotPublished):
        return UNPUBLISHED
    return CANNOT if isinstance(problem, (NameUnknown, NoConnection)) else 1


if __name__ == "__main__":
    sys.exit(main())
