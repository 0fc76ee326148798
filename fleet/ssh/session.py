"""How does a command run on a robot, within its time limit, over an open connection?"""

from __future__ import annotations

import contextlib
import shlex
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self

from fleet.errors import TimedOut
from fleet.ssh.channel import KEPT, Channel, ChannelPump, Transport

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable
    from types import TracebackType

    from fleet.ssh.channel import OnOutput, OnSent


ALLOW_FORWARDING = (
    "allow it in its sshd_config (`AllowTcpForwarding yes`), or remove `transport: registry` of this robot"
)
"""The cure where a robot shall pull through SSH and its sshd forwards no port."""


class ClosableChannel(Channel, Protocol):
    """A channel that can be closed."""

    def close(self) -> None:
        """Close it; output that was not read is lost."""


class Stream(Protocol):
    """A connection that was made at the robot: the part of ``paramiko.Channel`` that is used of it."""

    def settimeout(self, timeout: float | None) -> None:
        """Set the seconds for which `recv` and `sendall` wait."""

    def recv(self, nbytes: int) -> bytes:
        """Receive some bytes; none at the end."""

    def sendall(self, s: bytes) -> None:
        """Send all bytes."""

    def close(self) -> None:
        """Close it."""


class Connection(Transport, Protocol):
    """A transport that starts commands, and that can bring connections from the robot here."""

    def listen(self, take: Callable[[Stream], None]) -> int:
        """Let the robot listen on loopback, pass its connections to ``take``, and return the port. Raises as `begin`."""

    def cancel_port_forward(self, address: str, port: int) -> None:
        """End that."""

    def begin(self, command: str) -> ClosableChannel:
        """Start a shell command. Raises `LinkLost`, or `NotReady` if the robot refuses."""

    def close(self) -> None:
        """Close it at once, even while a command runs."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """A command's exit code (-1 for a signal) and its output, with undecodable bytes replaced."""

    code: int
    output: str
    errors: str


class Session:
    """One robot's connection. Make it with `fleet.ssh.connect.connect`; use it from one thread at a time; `close` from any.

    ``chain`` are the connections, each made through the one before; the last is the robot's. ``link_timeout`` is in seconds.
    """

    def __init__(self, *, chain: tuple[Connection, ...], link_timeout: float) -> None:
        self._chain = chain
        self._link_timeout = link_timeout

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; a command that runs on it raises `LinkLost`."""
        close(self._chain)

    def run(
        self,
        argv: tuple[str, ...],
        *,
        feed: Iterable[bytes] | None = (),
        limit: float | None = 60.0,
        on_sent: OnSent | None = None,
        on_output: OnOutput | None = None,
        on_errors: OnOutput | None = None,
        keep: int = KEPT,
    ) -> Result:
        """Run a command and wait for its end.

        ``feed`` becomes its standard input. ``None`` leaves the input open until the connection closes, with a byte every
        `fleet.ssh.channel.BEAT` seconds as a sign of life. ``limit`` is in seconds; ``timeout`` enforces it on the robot,
        so that no command runs on there. ``on_sent`` gets the number of bytes of each piece that was sent. ``on_output``
        gets standard output as it arrives, ``on_errors`` standard error; the result then does not have it. ``keep`` is how
        many bytes of each the result may have.

        If the feed fails, the connection is closed. The command then sees the end of its input, as after a lost link, so
        it must check that its input is complete.

        Raises:
            LinkLost: the connection was lost, or the robot fell silent.
            TimedOut: ``limit`` passed.
            NotReady: the robot cannot start a command.
            NotAsPlanned: the command printed more than is kept; the connection is closed then.
            Whatever ``feed``, ``on_sent``, ``on_output`` or ``on_errors`` raise; the connection is closed then.

        """
        bounded = argv if limit is None else ("timeout", "-k", "5", f"{limit:.10g}", *argv)
        started = time.monotonic()
        with contextlib.closing(self._start(f"cd; {shlex.join(bounded)}")) as channel:
            pump = ChannelPump(
                channel=channel, transport=self._chain[-1], link_timeout=self._link_timeout, keep=keep
            )
            try:
                code = pump.run(
                    feed=feed, limit=limit, on_sent=on_sent, on_output=on_output, on_errors=on_errors
                )
            except BaseException:
                self.close()
                raise
        # `timeout` exits with 124, or with the others after it killed. A command may return these codes early by itself.
        if limit is not None and time.monotonic() - started >= limit and code in (124, 137, 143, -1):
            what = f"`{argv[0]}` took longer than {limit:g} s and was stopped on the robot"
            raise TimedOut(what, cure="check whether the robot is overloaded")
        return Result(code=code, output=pump.output, errors=pump.errors)

    @contextlib.contextmanager
    def forwarded(self, serve: Callable[[Stream], None]) -> Generator[int]:
        """Listen on a port of the robot's loopback, which is yielded; each connection to it calls ``serve`` in a thread.

        Raises:
            LinkLost: the connection was lost.
            NotReady: the robot's sshd forwards no ports.

        """

        def take(stream: Stream) -> None:
            threading.Thread(target=_serve_and_close, args=(serve, stream), daemon=True).start()

        with self._watched():
            port = self._chain[-1].listen(take)
        try:
            yield port
        finally:
            with contextlib.suppress(Exception), self._watched():  # a lost link has ended it
                self._chain[-1].cancel_port_forward("127.0.0.1", port)

    def _start(self, command: str) -> ClosableChannel:
        with self._watched():
            return self._chain[-1].begin(command)

    @contextlib.contextmanager
    def _watched(self) -> Generator[None]:
        """Close the connection if this takes too long: Paramiko would wait forever for an sshd that is frozen."""
        watchdog = threading.Timer(self._link_timeout, self.close)
        watchdog.daemon = True
        watchdog.start()
        try:
            yield
        finally:
            watchdog.cancel()


def _serve_and_close(serve: Callable[[Stream], None], stream: Stream) -> None:
    # A connection that breaks is noticed at its other end, which has the error message.
    with contextlib.closing(stream), contextlib.suppress(Exception):
        serve(stream)


def close(chain: Iterable[Connection]) -> None:
    """Close connections, each made through the one before."""
    # The first holds the socket. If it were closed last, closing the others would wait for a dead link.
    for transport in chain:
        transport.close()
