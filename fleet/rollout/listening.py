"""How are the messages of a topic of many robots passed on as they arrive?

Each robot has a thread. Messages come over the network to this computer, or with ``via_robot`` from a listener on the robot,
through SSH.
"""

from __future__ import annotations

import re
import time
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from fleet.errors import NotAsPlanned
from fleet.plan.outcome import Outcome
from fleet.rollout.pool import each
from fleet.ros import listen, listen_ros2, measure, tcpros, via_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    from fleet.config.inventory import Robot
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress
    from fleet.ros.measure import Clocks
    from fleet.ros.message import Message
    from fleet.ros.rosmsg import Value

    Show = Callable[[str, Message, Clocks | None], bool]
    """Shows a message of a robot. Returns whether something was shown. Raises `RobotError`."""

    Note = Callable[[str, str], None]

QUESTIONS = 5
"""How often a robot is asked for its time: the shortest question counts."""

TYPES = 16
"""Definitions of the types of a topic that are kept; a topic has one, or two while its publisher is replaced."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is listened to. ``count``: how much is shown of each robot, 0 for all; ``timeout``: seconds without a message.

    ``clocks``: the clocks of the robots and of this computer are compared first.
    """

    topic: str
    count: int
    timeout: float
    via_robot: bool = False
    clocks: bool = False


class _Enough(Exception):
    """All is shown that was asked for."""


def hear(
    robots: Sequence[Robot], request: Request, *, show: Show, notes: Note, progress: Progress
) -> tuple[Outcome, ...]:
    """Pass a topic's messages on from each robot.

    ``notes`` gets sentences about a robot: what others do not get that arrives here, and how its clock differs.
    """

    def work(link: Link) -> Outcome:
        return _Ear(link, request, show=show, notes=notes).listen()

    return each(robots, work, progress=progress, at_once=len(robots))


class _Ear:
    """One robot, and what was shown of it."""

    def __init__(self, link: Link, request: Request, *, show: Show, notes: Note) -> None:
        self._link, self._request, self._notes = link, request, notes
        self._robot = link.robot
        self._show = show
        self._received = self._shown = 0
        self._clocks: Clocks | None = None

    def listen(self) -> Outcome:
        if self._request.clocks and not self._request.via_robot:
            self._clocks = clocks(self._link)
            self._note(str(self._clocks))
        try:
            if self._request.via_robot:
                self._listen_there()
            else:
                self._listen_here()
        except _Enough:
            pass
        summary = f"received {self._received} messages on {self._request.topic}"
        return Outcome(robot=self._robot.name, status="done", summary=summary)

    def _listen_here(self) -> None:
        with closing(self._messages()) as arriving:
            for message in arriving:
                self._take(message)

    def _messages(self) -> Generator[Message]:
        """Return the messages of a robot, by the ROS that it runs."""
        topic, timeout = self._request.topic, self._request.timeout
        if self._robot.ros.version == 1:
            return listen.messages(self._robot, topic, timeout=timeout)
        return listen_ros2.messages(
            self._robot, topic, timeout=timeout, on_robot=self._on_robot, on_note=self._note
        )

    def _listen_there(self) -> None:
        name = tcpros.resolved(self._request.topic, self._robot.ros.namespace or "")
        heard = via_robot.Heard(
            read=self._reader(name),
            on_message=self._take,
            on_container=lambda container: self._note(
                f"heard on the robot itself, in the container {container}, and not over the network; other robots of its "
                f"{'domain' if self._robot.ros.version == 2 else 'master'} may be among the publishers"
            ),
        )
        argv = via_robot.command(self._robot, name, timeout=self._request.timeout)
        result = self._link.session.run(argv, feed=None, limit=None, on_output=heard.on_output)
        raise heard.failure(self._robot, name, code=result.code, errors=result.errors)

    def _reader(self, topic: str) -> via_robot.Read:
        types = listen_ros2.Types(topic, self._on_robot)
        reader = lru_cache(TYPES)(partial(listen.reader, topic))

        def read(kind: str, definition: str, data: bytes) -> Mapping[str, Value]:
            if self._robot.ros.version == 1:
                return reader(kind, definition)(data)
            return types.read(kind, data)

        return read

    def _on_robot(self, argv: tuple[str, ...]) -> str:
        return self._link.run(*argv)

    def _note(self, text: str) -> None:
        self._notes(self._robot.name, text)

    def _take(self, message: Message) -> None:
        self._received += 1
        self._shown += self._show(self._robot.name, message, self._clocks)
        if self._request.count and self._shown >= self._request.count:
            raise _Enough


def clocks(link: Link) -> Clocks:
    """Compare a robot's clock with this computer's. Raises `NotAsPlanned` if the robot's `date` has no fractions."""
    asked = []
    for _ in range(QUESTIONS):
        sent = time.time()
        said = link.run("date", "+%s.%N", limit=20).strip()
        came = time.time()
        if not re.fullmatch(r"[0-9]{1,12}\.[0-9]{1,9}", said):
            raise NotAsPlanned(
                f"its clock cannot be compared with this computer's: `date` says {said[:40]!r}",
                cure="`fab listen --delay --via robot` needs only the robot's clock",
            )
        asked.append((sent, float(said), came))
    return measure.clocks(asked)
