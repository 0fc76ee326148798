"""How does a person's argv run on a robot, within its time, over a connection that is there?"""

from __future__ import annotations

import contextlib
import shlex
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self

from fleet.errors import TimedOut
from fleet.ssh.channel import Channel, ChannelPump, Transport

if TYPE_CHECKING:
    from collections.abc import Iterable
    from types import TracebackType

    from fleet.ssh.channel import OnOutput, OnSent


class ClosableChannel(Channel, Protocol):
    """A channel that can be given back."""

    def close(self) -> None:
        """Give it back; whatever it has not delivered is lost."""


class Connection(Transport, Protocol):
    """A transport that starts commands."""

    def begin(self, command: str) -> ClosableChannel:
        """Start a line of shell. Raises `LinkLost`, or `NotReady` where the robot does not."""

    def close(self) -> None:
        """End it, at once, whatever runs on it."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """How a command ended: its exit code (-1: by a signal), and what it wrote (undecodable bytes replaced)."""

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
        """End the connection; a command that runs on it ends with `LinkLost`."""
        close(self._chain)

    def run(
        self,
        argv: tuple[str, ...],
        *,
        feed: Iterable[bytes] | None = (),
        limit: float | None = 60.0,
        on_sent: OnSent | None = None,
        on_output: OnOutput | None = None,
    ) -> Result:
        """Run a command and wait for its end.

        ``feed`` becomes its standard input; ``None`` leaves that open until the connection closes, with
        a byte now and then as a sign of life (`fleet.ssh.channel.BEAT`). ``limit``
        is in seconds, and kept on the robot by ``timeout``, so that nothing runs on there. ``on_sent`` is told the bytes
        of each piece that left; ``on_output`` is given standard output as it comes, which then is not kept.

        A feed that fails ends the connection. For the command that is the end of its input, as it is when the link is
        cut: what must arrive whole has to be proven whole.

        Raises:
            LinkLost: the connection ended or fell silent.
            TimedOut: ``limit`` passed.
            NotReady: the robot starts no command.
            Whatever ``feed``, ``on_sent`` or ``on_output`` raise; the connection is closed then.

        """
        bounded = argv if limit is None else ("timeout", "-k", "5", f"{limit:.10g}", *argv)
        started = time.monotonic()
        with contextlib.closing(self._start(shlex.join(bounded))) as channel:
            pump = ChannelPump(channel=channel, transport=self._chain[-1], link_timeout=self._link_timeout)
            try:
                code = pump.run(feed=feed, limit=limit, on_sent=on_sent, on_output=on_output)
            except BaseException:
                self.close()
                raise
        # 124 is timeout's, the others say that it killed. A command may end with them early, on its own account.
        if limit is not None and time.monotonic() - started >= limit and code in (124, 137, 143, -1):
            what = f"`{argv[0]}` took longer than {limit:g} s and was ended on the robot"
            raise TimedOut(what, cure="is the robot overloaded?")
        return Result(code=code, output=pump.output, errors=pump.errors)

    def _start(self, command: str) -> ClosableChannel:
        # Paramiko waits without end for the answer of an sshd that is there and does nothing.
        watchdog = threading.Timer(self._link_timeout, self.close)
        watchdog.daemon = True
        watchdog.start()
        try:
            return self._chain[-1].begin(command)
        finally:
            watchdog.cancel()


def close(chain: Iterable[Connection]) -> None:
    """End connections, each made through the one before."""
    # The first holds the socket: were it the last, the others' farewells would wait for a dead link.
    for transport in chain:
        transport.close()
