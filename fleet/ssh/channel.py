"""How is one command on an SSH channel fed, heard and watched, so that it can never hang?

Works on a channel and a transport by their methods alone (Paramiko's, see `fleet.ssh.connect`). The caller's thread listens;
a second thread sends, because a command that fills its output while we fill its input would stop both.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, Protocol

from fleet.errors import LinkLost, TimedOut

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    OnSent = Callable[[int], None]
    OnOutput = Callable[[bytes], None]

PIECE = 128 * 1024
"""Bytes sent between two signs of progress."""

TICK = 0.1
"""Seconds between two looks at the clock while nothing comes; what comes is taken at once."""

GRACE = 15.0
"""Seconds a robot has to end a command itself at its limit, before the connection is cut from here."""

LINGER = 2.0
"""Seconds to wait for the end of output after a command has ended: something it started may hold its output open."""

BEAT = 10.0
"""Seconds between two signs of life to a command whose input is held open: from their end it knows that nobody listens."""

AGAIN = "see that the robot has power and signal, then run the same command again"


class Channel(Protocol):
    """What is used of ``paramiko.Channel``."""

    @property
    def status_event(self) -> threading.Event: ...
    def settimeout(self, timeout: float | None) -> None: ...
    def recv(self, nbytes: int) -> bytes: ...
    def recv_stderr_ready(self) -> bool: ...
    def recv_stderr(self, nbytes: int) -> bytes: ...
    def exit_status_ready(self) -> bool: ...
    def recv_exit_status(self) -> int: ...
    def send(self, s: bytes) -> int: ...
    def shutdown_write(self) -> None: ...


class Transport(Protocol):
    """What is used of ``paramiko.Transport``, which is a thread."""

    def is_active(self) -> bool: ...
    def is_alive(self) -> bool: ...
    def join(self, timeout: float | None = None) -> None: ...
    def global_request(self, kind: str, data: None = None, wait: bool = True) -> object: ...


class ChannelPump:
    """One command's input, output and end. Make one per command; `run` once; then read `output` and `errors`."""

    def __init__(self, *, channel: Channel, transport: Transport, link_timeout: float) -> None:
        self._channel = channel
        self._transport = transport
        self._link_timeout = link_timeout
        self._out: list[bytes] = []
        self._err: list[bytes] = []
        self._alive = time.monotonic()
        self._asked = False
        self._over = threading.Event()
        self._failed: BaseException | None = None

    @property
    def output(self) -> str:
        """Standard output so far, unless it went to a hearer."""
        return b"".join(self._out).decode(errors="replace")

    @property
    def errors(self) -> str:
        """Standard error so far."""
        return b"".join(self._err).decode(errors="replace")

    def run(
        self,
        *,
        feed: Iterable[bytes] | None,
        limit: float | None,
        on_sent: OnSent | None,
        on_output: OnOutput | None,
    ) -> int:
        """Feed and listen until the command ends; its exit code, or -1 where a signal ended it.

        Whatever is raised, the connection is of no more use: close it, and the sending thread ends too.

        Raises:
            LinkLost: the connection ended, or nothing was heard for the time of ``link_timeout``.
            TimedOut: the robot did not end the command at its limit.
            Whatever iterating ``feed``, ``on_sent`` or ``on_output`` raises.

        """
        self._channel.settimeout(TICK)
        deadline = float("inf") if limit is None else time.monotonic() + limit + GRACE
        if feed == ():
            self._end_input()
        elif feed is None:
            threading.Thread(target=self._beat, daemon=True).start()
        else:
            threading.Thread(target=self._send, args=(feed, on_sent), daemon=True).start()
        try:
            self._listen(on_output or self._out.append, deadline=deadline)
        finally:
            self._over.set()
        return self._code()

    def _listen(self, on_output: OnOutput, *, deadline: float) -> None:
        """Take what comes until the command has ended and all it wrote is here."""
        ended: float | None = None  # or when something was heard after the end
        while ended is None or self._lingers(ended):
            self._watch(deadline=deadline)
            self._hear_errors()
            try:
                data = self._channel.recv(1 << 20)
            except TimeoutError:
                data = None
            if data:
                self._alive = time.monotonic()
                on_output(data)
            if self._channel.exit_status_ready():
                if data == b"":
                    self._hear_errors()
                    return
                if data or ended is None:
                    ended = time.monotonic()
            elif data == b"":  # the command closed its output and runs on
                self._channel.status_event.wait(TICK)

    def _lingers(self, ended: float) -> bool:
        """Whether output may still come. A stalled link looks like one held open, so the robot has to answer."""
        if time.monotonic() < ended + LINGER:
            return True
        if self._alive <= ended:
            self._ask()
        return self._alive <= ended

    def _hear_errors(self) -> None:
        while self._channel.recv_stderr_ready() and (data := self._channel.recv_stderr(1 << 20)):
            self._alive = time.monotonic()
            self._err.append(data)

    def _code(self) -> int:
        code = self._channel.recv_exit_status()
        if self._failed:
            raise self._failed
        if code == -1:
            # Either a signal ended the command, or the connection is just coming down.
            self._transport.join(0.5)
            if not (self._transport.is_alive() and self._transport.is_active()):
                raise LinkLost("the connection was lost while the command ran", cure=AGAIN)
        return code

    def _send(self, feed: Iterable[bytes], on_sent: OnSent | None) -> None:
        """Send, in a thread of its own. What goes wrong is raised by the listening thread."""
        try:
            for chunk in feed:
                view = memoryview(chunk)
                for start in range(0, len(view), PIECE):
                    piece = view[start : start + PIECE]
                    if not self._push(piece):
                        return
                    if on_sent:
                        on_sent(len(piece))
        except BaseException as problem:  # noqa: BLE001  handed to the listening thread
            self._failed = problem
        else:
            self._end_input()
        finally:
            if close := getattr(feed, "close", None):
                close()

    def _beat(self) -> None:
        """Tell the command that somebody listens. That this could be sent says nothing about the robot."""
        with contextlib.suppress(OSError, EOFError):
            while not self._over.wait(BEAT):
                self._channel.send(b".")

    def _end_input(self) -> None:
        with contextlib.suppress(OSError, EOFError):
            self._channel.shutdown_write()

    def _push(self, piece: memoryview) -> bool:
        """Send a piece, however long it takes. False: nobody takes it, and the command's own output has the reason."""
        while piece:
            try:
                count = self._channel.send(piece)  # type: ignore[arg-type]  # takes any buffer, annotated bytes
            except TimeoutError:
                continue  # the robot is busy; the listening thread watches for how long
            except (OSError, EOFError):
                return False
            except Exception as problem:
                raise LinkLost(
                    f"the connection broke while bytes were sent: {problem}", cure=AGAIN
                ) from problem
            if not count:
                return False
            self._alive = time.monotonic()
            piece = piece[count:]
        return True

    def _watch(self, *, deadline: float) -> None:
        """Give up on a dead connection and on a command that will not end. TCP alone would wait for a quarter hour."""
        now = time.monotonic()
        quiet = now - self._alive
        if self._failed:
            raise self._failed
        if now > deadline:
            raise TimedOut(
                "the command did not end at its time limit, so the connection was cut",
                cure="is the robot busy?",
            )
        if quiet > self._link_timeout:
            what = f"nothing was heard from the robot for {quiet:.0f} s while the command ran"
            raise LinkLost(what, cure=AGAIN)
        if quiet > self._link_timeout / 3:
            self._ask()

    def _ask(self) -> None:
        """OpenSSH's ServerAliveInterval: any answer to ``keepalive@openssh.com``, a refusal too, is a sign of life."""
        if not self._asked:
            self._asked = True
            threading.Thread(target=self._await_answer, daemon=True).start()

    def _await_answer(self) -> None:
        with contextlib.suppress(OSError, EOFError):
            self._transport.global_request("keepalive@openssh.com", wait=True)
            if self._transport.is_active():
                self._alive = time.monotonic()
        self._asked = False
