"""How is one robot reached for as long as a verb works on it? A line connects when it is used, and again when it must."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from fleet.diagnosis import explain
from fleet.errors import CommandFailed, LinkLost, NotAsPlanned
from fleet.robot import facts, probe
from fleet.ssh import connect

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.config.inventory import Robot


class Link:
    """The line to one robot: connects when first used, can connect afresh, and is closed from outside on Ctrl-C."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._session: connect.Session | None = None
        self.closed = threading.Event()

    @property
    def session(self) -> connect.Session:
        """The connection. Raises what `fleet.ssh.connect.connect` raises."""
        if self.closed.is_set():
            raise LinkLost("interrupted by Ctrl-C")
        if self._session is None:
            self._session = connect.connect(self.robot)
            if self.closed.is_set():  # Ctrl-C came while it connected
                self._session.close()
        return self._session

    def reconnect(self) -> None:
        """Connect anew at the next use: group membership is read at login."""
        if self._session:
            self._session.close()
        self._session = None

    def close(self) -> None:
        """Close for good; whatever runs on it ends at once."""
        self.closed.set()
        if self._session:
            self._session.close()

    def run(self, *argv: str, limit: float = 60.0) -> str:
        """The output of a command that must succeed. Raises `CommandFailed`, or what the session raises."""
        return output_of(argv, self.session.run(argv, limit=limit))

    def facts(self, *, images: bool = False) -> facts.Facts:
        """What the robot has now, in one round trip; with ``images`` also what it holds of them."""
        answer = self.session.run(("sh", "-c", probe.probe(images=images)), limit=30)
        if f"{probe.MARK} end" not in answer.output:
            raise NotAsPlanned(
                f"the robot's shell did not run the probe: {answer.errors.strip() or 'no answer'}"
            )
        return probe.parse(answer.output)


def output_of(argv: Sequence[str], result: connect.Result, *, cure: str = "") -> str:
    """What a command wrote that must succeed. Raises `CommandFailed` with what its words mean."""
    if result.code == 0:
        return result.output
    said = result.errors.strip() or result.output.strip()
    what, known_cure = explain.explain(said)
    raise CommandFailed(
        what or f"`{argv[0]}` ended with code {result.code}",
        cure=known_cure or cure,
        code=result.code,
        output=said,
    )
