"""How does `fab dev` hear from a robot? One command holds the stack in dev while the desktop is connected, and tells of it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from fleet.errors import FleetError
from fleet.plan import watch
from fleet.rollout.link import output_of
from fleet.rollout.stream import Lines

if TYPE_CHECKING:
    from fleet.plan.watch import Change, Place, State
    from fleet.ssh.session import Session

_MOST = 100_000
"""Files that a robot may say it has: more than `fleet.rollout.saved_files.MOST` are no answer."""

_LONGEST = 5000
"""Characters of one such line: Linux has paths of up to 4096."""

_MOST_PARTS = 100

_LAST_LINES = 8
"""Log lines of a container that has ended; ``onboard/dev_hold.sh`` has the number too."""


class Hold:
    """The command ``onboard/dev_hold.sh``, and what it has said so far. It ends with the connection.

    ``has`` is what the robot's containers have, ``parts`` the uploads that were cut, with their bytes. ``states`` is how
    the containers are, ``said`` the last log lines of those that have ended. ``over`` is set when the command has ended.
    ``changed`` is notified of all this.
    """

    def __init__(self, session: Session, argv: tuple[str, ...], *, changed: threading.Condition) -> None:
        self._connection = session
        self._argv = argv
        self._changed = changed
        self._ready = threading.Event()
        self._problem: Exception | None = None
        self._ended = ""
        self.has: dict[Place, str] = {}
        self.parts: dict[str, int] = {}
        self.said: list[tuple[str, str]] = []
        self.states: tuple[State, ...] = ()
        self.over = False

    def start(self) -> None:
        """Start the command, and wait until the stack is in dev. Raises why it cannot be."""
        threading.Thread(target=self._run, daemon=True).start()
        self._ready.wait()
        if self._problem:
            raise self._problem

    def end(self) -> str:
        """Return the event that has brought the robot back to a release. Raises the error that has ended the command."""
        if self._problem:
            raise self._problem
        return self._ended

    def forget(self, changes: tuple[Change, ...]) -> None:
        """Take what is about to be changed as unknown."""
        for one in changes:
            self.has.pop((one.service, one.place), None)

    def remember(self, changes: tuple[Change, ...]) -> None:
        """Note what the containers have got."""
        self.has |= {(one.service, one.place): one.digest for one in changes}

    def _run(self) -> None:
        lines = Lines(self._hear)
        try:
            result = self._connection.run(self._argv, feed=None, limit=None, on_output=lines.on_output)
            output_of(self._argv, result, verb="dev")
        except (FleetError, OSError, EOFError) as problem:
            self._problem = problem
        with self._changed:
            self.over = True
            self._ready.set()
            self._changed.notify_all()

    def _hear(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        match word, rest.split(" ", 2):
            case "has" | "part", _ if self._ready.is_set():
                pass  # from then on, this side changes what it has
            case "has", [service, digest, place] if len(self.has) < _MOST and len(line) < _LONGEST:
                self.has[service, place] = digest
            case "part", [name, size] if (
                size.isdecimal() and len(size) < 16 and len(self.parts) < _MOST_PARTS
            ):
                self.parts[name] = int(size)
            case "said", [service, *text]:
                self.said = [*self.said, (service, " ".join(text))][-_LAST_LINES:]
            case "ready", _:
                self._ready.set()
            case "ended", _:
                self._ended = rest
            case "states", _:
                with self._changed:
                    self.states = watch.states(rest)
                    self._changed.notify_all()
            case _:
                pass
