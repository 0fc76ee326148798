"""How is a topic heard on the robot itself, in one of its containers?

For desktops that have no way to the nodes of a robot but SSH. `onboard/hear.sh` starts a program in a container that has ROS,
and the program prints each message as a line of JSON. Pure: lines in, messages out.
"""

from __future__ import annotations

import base64
import binascii
import json
from functools import partial
from importlib import resources
from math import isfinite
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.errors import NotAsPlanned, NotReady
from fleet.ros import environment
from fleet.ros.message import Message

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from fleet.config.inventory import Robot
    from fleet.ros import rosmsg

    Read = Callable[[str, str, bytes], Mapping[str, rosmsg.Value]]
    """Reads a message: its type and the definition of that, "" with ROS 2, and its bytes. Raises `NotAsPlanned`."""

LARGEST_LINE = 96 << 20
"""Bytes of a line: a message of 64 MiB and more. A longer one ends the connection."""

_PROGRAMS = {1: "tcpros.py", 2: "ros2_check.py"}
MOST_CONTAINERS, LONGEST_NAME = 1000, 256
"""Of a robot, whose reasons are kept; and characters of a container's name: Docker allows 255 bytes at most."""

_CANNOT = 3  # what hear.sh ends with


def command(robot: Robot, topic: str, *, timeout: float) -> tuple[str, ...]:
    """Return the command that prints the messages of a topic, until its input ends. ``timeout``: see `ros2_check`."""
    program = (resources.files("fleet.ros") / _PROGRAMS[robot.ros.version]).read_text(encoding="utf-8")
    script = onboard.text("hear.sh")
    deciding = environment.VARIABLES[robot.ros.version][0]
    variable = f"{deciding}={environment.environment(robot)[deciding]}"
    return ("sh", "-c", script, "hear", variable, program, topic, "--timeout", f"{timeout:g}", "--all")


class Heard:
    """The output of that command, as it arrives. ``on_message`` gets messages, ``on_container`` a container's name."""

    def __init__(
        self, *, read: Read, on_message: Callable[[Message], None], on_container: Callable[[str], None]
    ) -> None:
        self._read, self._on_message, self._on_container = read, on_message, on_container
        self._parts: list[bytes] = []
        self._size = 0
        self._container = ""
        self._reasons: dict[str, str] = {}  # of each container, the last one
        self._told = False

    def on_output(self, data: bytes) -> None:
        """Take the next bytes. Raises `NotAsPlanned` if they make no sense, and what ``on_message`` raises."""
        *whole, rest = data.split(b"\n")
        for end in whole:
            line, self._parts, self._size = b"".join((*self._parts, end)), [], 0
            self._line(line)
        self._parts.append(rest)
        self._size += len(rest)
        if self._size > LARGEST_LINE:
            raise NotAsPlanned(f"the robot sent a line of more than {LARGEST_LINE >> 20} MiB")

    def _line(self, line: bytes) -> None:
        if line.startswith(b"== "):
            self._container = line[3:].decode(errors="replace")[:LONGEST_NAME]
        elif line.startswith(b"{"):
            message = self._message(line)
            if not self._told:
                self._told = True
                self._on_container(self._container)
            self._on_message(message)
        elif line.strip() and len(self._reasons) < MOST_CONTAINERS:
            self._reasons[self._container] = line.decode(errors="replace")[:500]

    def _message(self, line: bytes) -> Message:
        try:
            said = json.loads(line)
            data = base64.b64decode(said["data"], validate=True)
            kind, definition = str(said["type"]), str(said.get("definition", ""))
            at, monotonic = float(said["at"]), float(said["monotonic"])
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError, binascii.Error) as problem:
            raise _no_message(line) from problem
        if not isfinite(at) or not isfinite(monotonic):
            raise _no_message(line)
        read = partial(self._read, kind, definition, data)
        return Message(at=at, monotonic=monotonic, size=len(data), read=read)

    def failure(self, robot: Robot, topic: str, *, code: int, errors: str) -> NotAsPlanned | NotReady:
        """Return why the command ended."""
        status = f"`fab status --hosts {robot.name}` shows whether its containers run"
        reason = self._reasons.get(self._container, "") or next(iter(errors.strip().splitlines()[-1:]), "")
        if code == _CANNOT:
            lacks = "none has rclpy" if robot.ros.version == 2 else "none has Python 3"
            return NotReady(
                f"no container of {robot.name} can listen: {reason.removeprefix(f'{topic}: ') or lacks}",
                cure=status,
            )
        if not self._container:
            return NotAsPlanned(
                f"the containers of {robot.name} cannot be asked: {reason or f'code {code}'}", cure=status
            )
        said = reason.removeprefix(f"{topic}: ") or f"the program ended with code {code}"
        return NotAsPlanned(
            f"{topic} is not heard on {robot.name} itself, in the container {self._container}: {said}",
            cure=f"`fab logs --hosts {robot.name}` shows what the nodes do",
        )


def _no_message(line: bytes) -> NotAsPlanned:
    return NotAsPlanned(f"the robot sent a line that is not a message: {line[:80]!r}")
