"""How is one command on an SSH channel fed, heard and watched, so that it can never hang?

Works on a channel and a transport by their methods alone (Paramiko's, see `fleet.ssh`). The caller's thread listens;
a second thread sends, because a command that fills its output while we fill its input would stop both.
"""

from __future__ import annotations

import contextlib
import select
import threading
import time
from typing import TYPE_CHECKING, Protocol

from fleet.errors import LinkLost, TimedOut

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    Teller = Callable[[int], None]
    Hearer = Callable[[bytes], None]

PIECE = 128 * 1024
"""Bytes sent between two signs of progress."""

GRACE = 15.0
"""Seconds a robot has to end a command itself at its limit, before the connection is cut from here."""

LINGER = 2.0
"""Seconds to wait for the end of output after a command has ended: something it started may hold its output open."""


class Channel(Protocol):
    """What is used of ``paramiko.Channel``."""

    @property
    def eof_received(self) -> int: ...
    @property
    def closed(self) -> bool: ...
    def fileno(self) -> int: ...
    def recv_ready(self) -> bool: ...
    def recv(self, nbytes: int) -> bytes: ...
    def recv_stderr_ready(self) -> bool: ...
    def recv_stderr(self, nbytes: int) -> bytes: ...
    def exit_status_ready(self) -> bool: ...
    def recv_exit_status(self) -> int: ...
    def sendall(self, s: bytes) -> None: ...
    def shutdown_write(self) -> None: ...


class Transport(Protocol):
    """What is used of ``paramiko.Transport``."""

    def is_active(self) -> bool: ...
    def global_request(self, kind: str, data: None = None, wait: bool = True) -> object: ...
    def close(self) -> None: ...


class Exchange:
    """One command's input, output and end. Make one per command; `run` once; then read `output` and `errors`."""

    def __init__(self, *, channel: Channel, transport: Transport, silence: float) -> None:
        self._channel = channel
        self._transport = transport
        self._silence = silence
        self._out: list[bytes] = []
        self._err: list[bytes] = []
        self._alive = time.monotonic()
        self._asked = False
        self._feed_failed: BaseException | None = None

    @property
    def output(self) -> str:
        """Standard output so far, unless it went to a hearer."""
        return b"".join(self._out).decode(errors="replace")

    @property
    def errors(self) -> str:
        """Standard error so far."""
        return b"".join(self._err).decode(errors="replace")

    def run(
        self, *, feed: Iterable[bytes] | None, limit: float | None, sent: Teller | None, heard: Hearer | None
    ) -> int:
        """Feed and listen until the command ends; its exit code.

        Raises:
            LinkLost: the connection ended, or nothing was heard for the time of ``silence``.
            TimedOut: the robot did not end the command at its limit.
            Whatever iterating ``feed`` raises.

        """
        started = self._alive = time.monotonic()
        if feed is not None:
            threading.Thread(target=self._send, args=(feed, sent), daemon=True).start()
        poll = select.poll()
        poll.register(self._channel.fileno(), select.POLLIN)
        ended: float | None = None
        while not self._drain(heard) or ended is None or not self._channel.eof_received:
            if self._feed_failed:
                self._transport.close()
                raise self._feed_failed
            now = time.monotonic()
            if ended is None and self._channel.exit_status_ready():
                ended = now
            if self._channel.closed or (ended is not None and now - ended > LINGER):
                break
            self._watch(now=now, overdue=limit is not None and now - started > limit + GRACE)
            poll.poll(200)
        self._drain(heard)
        code = self._channel.recv_exit_status() if self._channel.exit_status_ready() else -1
        if self._feed_failed:
            raise self._feed_failed
        if code == -1:
            raise LinkLost("the connection was lost while the command ran")
        return code

    def _drain(self, heard: Hearer | None) -> bool:
        """Take what has arrived. Returns whether there was nothing."""
        nothing = True
        while self._channel.recv_ready() and (data := self._channel.recv(1 << 20)):
            nothing = False
            heard(data) if heard else self._out.append(data)
        while self._channel.recv_stderr_ready() and (data := self._channel.recv_stderr(1 << 20)):
            nothing = False
            self._err.append(data)
        if not nothing:
            self._alive = time.monotonic()
        return nothing

    def _send(self, feed: Iterable[bytes], sent: Teller | None) -> None:
        """Send, in a thread of its own. A command that ends early closes its input; its own output has the reason."""
        try:
            for chunk in feed:
                view = memoryview(chunk)
                for start in range(0, len(view), PIECE):
                    piece = view[start : start + PIECE]
                    try:
                        self._channel.sendall(piece)  # type: ignore[arg-type]  # takes any buffer, annotated bytes
                    except OSError:
                        return
                    self._alive = time.monotonic()
                    if sent:
                        sent(len(piece))
        except BaseException as problem:  # noqa: BLE001  handed to the listening thread, which raises it
            self._feed_failed = problem
        else:
            with contextlib.suppress(OSError, EOFError):
                self._channel.shutdown_write()
        finally:
            if close := getattr(feed, "close", None):
                close()

    def _watch(self, *, now: float, overdue: bool) -> None:
        """Cut a connection that is dead or whose command will not end. TCP alone would wait for a quarter of an hour."""
        if overdue:
            self._transport.close()
            raise TimedOut("the command did not end at its time limit, so the connection was cut")
        if not self._transport.is_active():
            raise LinkLost("the connection was lost while the command ran")
        quiet = now - self._alive
        if quiet > self._silence:
            self._transport.close()
            raise LinkLost(f"nothing was heard from the robot for {quiet:.0f} s, so the connection was cut")
        if quiet > self._silence / 3 and not self._asked:
            self._asked = True
            threading.Thread(target=self._ask, daemon=True).start()

    def _ask(self) -> None:
        """OpenSSH's ServerAliveInterval: any answer to ``keepalive@openssh.com``, a refusal too, is a sign of life."""
        with contextlib.suppress(OSError, EOFError):
            self._transport.global_request("keepalive@openssh.com", wait=True)
            if self._transport.is_active():
                self._alive = time.monotonic()
        self._asked = False
