"""How does one command on an SSH channel get its input, and how is its output read without ever hanging?

The channel and the transport are used by their methods only (Paramiko's, see `fleet.ssh.connect`). The caller's thread
reads, and a second thread sends: with one thread, a command that fills its output while we fill its input would block both.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import TYPE_CHECKING, Protocol

from fleet.errors import LinkLost, NotAsPlanned, TimedOut
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    OnSent = Callable[[int], None]
    OnOutput = Callable[[bytes], None]

PIECE = 128 * 1024
"""Bytes sent between two progress reports."""

TICK = 0.1
"""Seconds between two checks of the time limits while no output arrives; output is read at once."""

GRACE = 15.0
"""Seconds that a robot has to stop a command at its limit, before the desktop cuts the connection."""

LINGER = 2.0
"""Seconds to wait for the end of output after a command has ended: a process it started may hold the output open."""

BEAT = 10.0
"""Seconds between two bytes that tell a command with open input that the desktop still listens."""

KEPT = 4_000_000
"""Bytes of output that are kept, and as many of errors: answers have some thousand. A robot that prints more is not read on."""

TAKES_WITHIN = 900.0
"""Seconds in which a robot must take the next bytes of a stream: a slow card is busy for a minute, not for a quarter of an hour."""

ENDS_WITHIN = 7200.0
"""Seconds in which a command without a limit must end after the last byte it was sent: `docker load` of 10 GB takes an hour."""

READS = 16
"""Reads of errors between two looks at the output and the clock: errors without end must not hide them."""

AGAIN = "check the robot's power and network, then run the same command again"


class Channel(Protocol):
    """The part of ``paramiko.Channel`` that is used here."""

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
    """The part of ``paramiko.Transport`` (a thread) that is used here."""

    def is_active(self) -> bool: ...
    def is_alive(self) -> bool: ...
    def join(self, timeout: float | None = None) -> None: ...
    def global_request(self, kind: str, data: None = None, wait: bool = True) -> object: ...


class Kept:
    """Bytes that are kept, up to a number."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._pieces: list[bytes] = []
        self._size = 0

    def add(self, data: bytes) -> None:
        """Keep the next bytes. Raises `NotAsPlanned` if they are too many."""
        self._size += len(data)
        if self._size > self._most:
            self._pieces.clear()
            what = f"the robot printed more than {human_bytes(self._most)}, so it was not read any further"
            raise NotAsPlanned(what, cure="log in and see what its shell and its `docker` print")
        self._pieces.append(data)

    def text(self) -> str:
        """All of it, with undecodable bytes replaced."""
        return b"".join(self._pieces).decode(errors="replace")


class ChannelPump:
    """One command's input, output and end. Make one per command, call `run` once, then read `output` and `errors`.

    ``keep`` is the number of bytes that are kept of each.
    """

    def __init__(
        self, *, channel: Channel, transport: Transport, link_timeout: float, keep: int = KEPT
    ) -> None:
        self._channel = channel
        self._transport = transport
        self._link_timeout = link_timeout
        self._out = Kept(keep)
        self._err = Kept(keep)
        self._on_errors: OnOutput = self._err.add
        self._alive = time.monotonic()
        self._asked = False
        self._must_move = float("inf")  # when the robot must have taken the bytes it is being sent, or ended
        self._over = threading.Event()
        self._failed: BaseException | None = None

    @property
    def output(self) -> str:
        """Standard output so far, unless ``on_output`` received it."""
        return self._out.text()

    @property
    def errors(self) -> str:
        """Standard error so far, unless ``on_errors`` received it."""
        return self._err.text()

    def run(
        self,
        *,
        feed: Iterable[bytes] | None,
        limit: float | None,
        on_sent: OnSent | None,
        on_output: OnOutput | None,
        on_errors: OnOutput | None = None,
    ) -> int:
        """Send input and read output until the command ends. Returns its exit code, or -1 if a signal ended it.

        After any exception the connection cannot be used again: close it, which also ends the sending thread.

        Raises:
            LinkLost: the connection was lost, or the robot was silent for ``link_timeout`` seconds.
            TimedOut: the robot did not stop the command at its limit, or did not take what it was sent.
            NotAsPlanned: it printed more than is kept.
            Whatever iterating ``feed``, ``on_sent``, ``on_output`` or ``on_errors`` raises.

        """
        self._channel.settimeout(TICK)
        deadline = float("inf") if limit is None else time.monotonic() + limit + GRACE
        if feed == ():
            self._end_input()
        elif feed is None:
            threading.Thread(target=self._beat, daemon=True).start()
        else:
            ends_within = ENDS_WITHIN if limit is None else float("inf")
            threading.Thread(target=self._send, args=(feed, on_sent, ends_within), daemon=True).start()
        try:
            self._on_errors = on_errors or self._err.add
            self._read(on_output or self._out.add, deadline=deadline)
        finally:
            self._over.set()
        return self._code()

    def _read(self, on_output: OnOutput, *, deadline: float) -> None:
        """Read until the command has ended and all its output has arrived."""
        ended: float | None = None  # later: when the last output after the end arrived
        while ended is None or self._lingers(ended):
            self._check(deadline=deadline)
            try:
                data = self._channel.recv(1 << 20)
            except TimeoutError:
                data = None
            if data:
                self._alive = time.monotonic()
                on_output(data)
            self._read_errors()
            if self._channel.exit_status_ready():
                if data == b"":
                    while self._read_errors():
                        self._check(deadline=deadline)
                    return
                if data or ended is None:
                    ended = time.monotonic()
            elif data == b"":  # the command closed its output and still runs
                self._channel.status_event.wait(TICK)

    def _lingers(self, ended: float) -> bool:
        """Whether more output may come. A stalled link looks like held-open output, so the robot must answer a question."""
        if time.monotonic() < ended + LINGER:
            return True
        if self._alive <= ended:
            self._ask()
        return self._alive <= ended

    def _read_errors(self) -> bool:
        """Read errors that have arrived, and return whether there may be more."""
        for _ in range(READS):
            if not (self._channel.recv_stderr_ready() and (data := self._channel.recv_stderr(1 << 20))):
                return False
            self._alive = time.monotonic()
            self._on_errors(data)
        return True

    def _code(self) -> int:
        code = self._channel.recv_exit_status()
        if self._failed:
            raise self._failed
        if code == -1:
            # Either a signal ended the command, or the connection is being lost right now.
            self._transport.join(0.5)
            if not (self._transport.is_alive() and self._transport.is_active()):
                raise LinkLost("the connection was lost while the command ran", cure=AGAIN)
        return code

    def _send(self, feed: Iterable[bytes], on_sent: OnSent | None, ends_within: float) -> None:
        """Send the feed, in a thread of its own. The reading thread raises any error."""
        try:
            for chunk in feed:
                view = memoryview(chunk)
                for start in range(0, len(view), PIECE):
                    piece = view[start : start + PIECE]
                    if not self._push(piece):
                        return
                    if on_sent:
                        on_sent(len(piece))
        except BaseException as problem:  # noqa: BLE001  raised by the reading thread
            self._failed = problem
        else:
            self._must_move = time.monotonic() + ends_within
            self._end_input()
        finally:
            if close := getattr(feed, "close", None):
                close()

    def _beat(self) -> None:
        """Tell the command that the desktop still listens. A successful send does not prove that the robot is alive."""
        with contextlib.suppress(OSError, EOFError):
            while not self._over.wait(BEAT):
                self._channel.send(b".")

    def _end_input(self) -> None:
        with contextlib.suppress(OSError, EOFError):
            self._channel.shutdown_write()

    def _push(self, piece: memoryview) -> bool:
        """Send a piece, however long it takes. Returns False if the command no longer reads; its output has the reason."""
        while piece:
            self._must_move = min(self._must_move, time.monotonic() + TAKES_WITHIN)
            try:
                count = self._channel.send(piece)  # type: ignore[arg-type]  # takes any buffer, annotated bytes
            except TimeoutError:
                continue  # the robot is busy; the reading thread enforces the time limits
            except (OSError, EOFError):
                return False
            except Exception as problem:
                raise LinkLost(
                    f"the connection was lost while bytes were sent: {problem}", cure=AGAIN
                ) from problem
            self._must_move = float("inf")
            if not count:
                return False
            self._alive = time.monotonic()
            piece = piece[count:]
        return True

    def _check(self, *, deadline: float) -> None:
        """Raise if the connection is dead or the command does not end. TCP alone would wait for 15 minutes."""
        now = time.monotonic()
        quiet = now - self._alive
        if self._failed:
            raise self._failed
        if now > deadline:
            raise TimedOut(
                "the command did not stop at its time limit, so the connection was cut",
                cure="check whether the robot is overloaded",
            )
        if now > self._must_move:
            raise TimedOut(
                "the robot answers, but it does not go on with what it was sent, so the connection was cut",
                cure="see what its `docker` is doing, or restart it",
            )
        if quiet > self._link_timeout:
            what = f"nothing was heard from the robot for {quiet:.0f} s while the command ran"
            raise LinkLost(what, cure=AGAIN)
        if quiet > self._link_timeout / 3:
            self._ask()

    def _ask(self) -> None:
        """Ask for a sign of life, as OpenSSH's ServerAliveInterval does: any answer counts, a refusal too."""
        if not self._asked:
            self._asked = True
            threading.Thread(target=self._await_answer, daemon=True).start()

    def _await_answer(self) -> None:
        with contextlib.suppress(OSError, EOFError):
            self._transport.global_request("keepalive@openssh.com", wait=True)
            if self._transport.is_active():
                self._alive = time.monotonic()
        self._asked = False
