"""How is one robot reached while a verb works on it?"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from fleet.diagnosis import explain
from fleet.errors import CommandFailed, LinkLost, NotAsPlanned
from fleet.robot import facts, probe
from fleet.ssh import connect
from fleet.ssh.approach import Approach

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.config.inventory import Robot


GOES_ON = "the robot goes on by itself: `fab status` shows the result"
"""What a person is told who leaves a robot while it swaps its containers."""


_PARSING = threading.Lock()
"""Answers are read one after the other: a strange one may need much memory for a moment."""

_TOLD = 32_000
"""Characters from the end of a command's errors that are told and looked at."""


class Link:
    """The link to one robot. It connects at its first use, can reconnect, and is closed by another thread on Ctrl-C.

    ``connect_timeout`` is in seconds, see `fleet.ssh.connect.CONNECT_TIMEOUT`.
    """

    def __init__(self, robot: Robot, *, connect_timeout: float = connect.CONNECT_TIMEOUT) -> None:
        self.robot = robot
        self._connect_timeout = connect_timeout
        self._approach = Approach()
        self._session: connect.Session | None = None
        self.closed = threading.Event()
        self.goes_on = False
        """Whether what runs on the robot goes on without this link."""

    @property
    def silence(self) -> float:
        """Seconds that the robot lets us wait for the first word of its answer; 0 otherwise."""
        return self._approach.silence

    @property
    def session(self) -> connect.Session:
        """The connection. Raises what `fleet.ssh.connect.connect` raises."""
        if self.closed.is_set():
            raise LinkLost("interrupted by Ctrl-C")
        if self._session is None:
            self._session = connect.connect(
                self.robot, connect_timeout=self._connect_timeout, approach=self._approach
            )
            if self.closed.is_set():  # Ctrl-C came while it connected
                self._session.close()
        return self._session

    def reconnect(self) -> None:
        """Use a new connection from now on. A new login also reads the user's groups again."""
        if self._session:
            self._session.close()
        self._session = None

    def close(self) -> None:
        """Close for good; a command that runs on the link ends at once."""
        self.closed.set()
        if self._session:
            self._session.close()

    def run(self, *argv: str, limit: float = 60.0) -> str:
        """Return the output of a command that must succeed. Raises `CommandFailed`, or what the session raises."""
        return output_of(argv, self.session.run(argv, limit=limit))

    def facts(self, *, images: bool = False) -> facts.Facts:
        """Return the robot's facts, read in one round trip; with ``images`` also those about its images."""
        keep = probe.LONGEST_WITH_IMAGES if images else probe.LONGEST
        answer = self.session.run(probe.command(images=images), limit=30, keep=keep)
        if f"{probe.MARK} end" not in answer.output:
            raise _no_probe(answer)
        with _PARSING:
            return probe.parse(answer.output)


def _no_probe(answer: connect.Result) -> NotAsPlanned:
    """Why a login does not run the probe: a csh, a login without a shell, a system without `timeout`."""
    what, cure = explain.explain(f"{answer.errors}\n{answer.output}", code=answer.code)
    if cure:
        return NotAsPlanned(what, cure=cure)
    said = explain.explain(answer.errors)[0] or "no answer"
    return NotAsPlanned(
        f"the robot's shell did not run the probe: {said}",
        cure="`fab shell` shows what a login gets; fleet needs one that runs commands in a POSIX shell",
    )


def output_of(argv: Sequence[str], result: connect.Result, *, cure: str = "", verb: str = "") -> str:
    """Return the output of a command that must succeed. Raises `CommandFailed`, which explains the error output.

    ``cure`` is for an unknown error; ``verb`` is the verb that runs.
    """
    if result.code == 0:
        return result.output
    error_output = (result.errors.strip() or result.output.strip())[-_TOLD:]
    what, known_cure = explain.explain(error_output, code=result.code, verb=verb)
    raise CommandFailed(
        what or f"`{argv[0]}` ended with code {result.code}",
        cure=known_cure or cure,
        code=result.code,
        output=error_output,
    )
