"""Does a ROS 2 container send messages? One real message is read, as a node of the same container would read it.

A single file, as `tcpros` is for ROS 1, for the health check of a container. It needs the container's own ROS (rclpy), so
it hears each middleware and each type that the container has. A container starts a health check without the environment
of ROS; then the check takes the one that the container's program was started with::

    healthcheck:
      test: ["CMD", "python3", "/usr/local/lib/fleet/ros2_check.py", "/chatter", "--timeout", "10"]

With ``--all``, it prints each message as a line of JSON, until its input ends: so `fab listen --via robot` hears a topic.
Then the codes `NO_ROS` and `UNPUBLISHED` mean that another container may hear it.

Good for Python 3.8. All times are in seconds.
"""

from __future__ import annotations

import argparse
import base64
import importlib
import json
import os
import re
import select
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

TURN = 0.1  # between two looks for a publisher
NODE = "_fleet_check"  # the underscore hides it from `ros2 node list`
SIGN_OF_LIFE = 45.0  # a desktop that listens sends a byte every ten seconds
NO_ROS, UNPUBLISHED = 3, 4  # exit codes
WAITING = 100  # messages that may wait to be printed: 0.1 s of a fast sensor; more camera images would fill the memory
WAITING_KEPT = 1000  # of a topic that keeps its messages: as many as /rosout keeps; all of them come at once


class NoMessage(Exception):
    """No message was read; the text says why."""


class NoRos(NoMessage):
    """There is no rclpy here."""


class NotPublished(NoMessage):
    """No publisher of the topic was found."""


class Taken(NamedTuple):
    """A message: its type and bytes, and when it was taken, in seconds since 1970 and by a clock that nobody sets."""

    type: str
    data: bytes
    at: float
    monotonic: float


def adopted(processes: Path) -> dict[str, str]:
    """Return the environment of the first process that has one of ROS, {} if none has; ``processes`` is ``/proc``."""
    for process in sorted((path for path in processes.glob("[0-9]*")), key=lambda path: int(path.name)):
        try:
            raw = (process / "environ").read_bytes()
        except OSError:
            continue
        pairs = (entry.partition("=") for entry in os.fsdecode(raw).split("\0"))
        found = {name: value for name, equals, value in pairs if equals}
        if "AMENT_PREFIX_PATH" in found:
            return found
    return {}


def overruled() -> dict[str, str]:
    """Return the variables that whoever runs this program has set for it, over those of the container's program."""
    return {name: value for name, value in os.environ.items() if name == "FASTDDS_BUILTIN_TRANSPORTS"}


def resolved(topic: str, namespace: str) -> str:
    """Return a topic's full name: a relative one follows the namespace, as a node's own would."""
    return topic if topic.startswith("/") else "/" + "/".join(p for p in (namespace.strip("/"), topic) if p)


def listen(topic: str, *, timeout: float, every: bool, on_message: Callable[[Taken], bool]) -> None:
    """Give the messages of a topic to ``on_message``, until that returns False.

    ``every``: none of them may be missed; otherwise any one will do. Raises `NoMessage` if none comes for ``timeout`` seconds.
    """
    try:
        rclpy = importlib.import_module("rclpy")
    except ImportError as problem:
        raise NoRos(f"rclpy cannot be imported ({problem})") from problem
    rclpy.init(args=[])
    try:
        node = rclpy.create_node(NODE, start_parameter_services=False, enable_rosout=False)
        _listen(rclpy, node, topic, timeout, every, on_message)
    finally:
        rclpy.shutdown()


def _listen(
    rclpy: Any,  # noqa: ANN401  rclpy has no types
    node: Any,  # noqa: ANN401
    topic: str,
    timeout: float,
    every: bool,
    on_message: Callable[[Taken], bool],
) -> None:
    messages: list[Taken] = []
    subscription, kind = None, ""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        publishers = [] if subscription else node.get_publishers_info_by_topic(topic)
        if publishers:
            kind = publishers[0].topic_type
            quality = _quality(publishers, every=every)
            take = _taking(kind, messages)
            subscription = node.create_subscription(_type(kind), topic, take, quality, raw=True)
        rclpy.spin_once(node, timeout_sec=TURN)
        while messages:
            deadline = time.monotonic() + timeout
            if not on_message(messages.pop(0)):
                return
    if not subscription:
        raise NotPublished("nobody publishes it")
    raise NoMessage(f"its publisher sent nothing for {timeout:g} s")


def _taking(kind: str, messages: list[Taken]) -> Callable[[bytes], None]:
    """Return what rclpy calls with each message. It takes one argument: with two, rclpy would give it more."""

    def take(data: bytes) -> None:
        messages.append(Taken(kind, data, time.time(), time.monotonic()))

    return take


def show(message: Taken) -> bool:
    """Print a message as a line of JSON."""
    line = {**message._asdict(), "data": base64.b64encode(message.data).decode()}
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()
    return True


def end_with_input() -> None:
    """End this program as soon as its input ends or falls silent, as when the connection to the desktop is lost."""

    def watch() -> None:
        while select.select([0], [], [], SIGN_OF_LIFE)[0] and os.read(0, 1):
            pass
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


def _type(name: str) -> Any:  # noqa: ANN401  the class of a message
    """Return the class of a type such as ``std_msgs/msg/String``."""
    match = re.fullmatch(r"(\w+)/(\w+)/(\w+)", name)
    if not match:
        raise NoMessage(f"{name!r} is not a type of ROS")
    package, folder, kind = match.groups()
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), kind)
    except (ImportError, AttributeError) as problem:
        raise NoMessage(f"this container has no Python package with {name}") from problem


def _quality(publishers: Any, *, every: bool) -> Any:  # noqa: ANN401  a quality of service of rclpy
    """Return what fits each publisher; if all of them keep their last messages, these are asked for."""
    qos = importlib.import_module("rclpy.qos")
    kept = qos.DurabilityPolicy.TRANSIENT_LOCAL
    late = all(one.qos_profile.durability == kept for one in publishers)
    return qos.QoSProfile(
        depth=(WAITING_KEPT if late else WAITING) if every else 1,
        reliability=qos.ReliabilityPolicy.RELIABLE if late else qos.ReliabilityPolicy.BEST_EFFORT,
        durability=kept if late else qos.DurabilityPolicy.VOLATILE,
    )


def main() -> int:
    """Read one message: 0 when it came, otherwise the reason and 1; with ``--all``, also `NO_ROS` or `UNPUBLISHED`."""
    options = argparse.ArgumentParser(description="Read one message of a ROS 2 topic.")
    options.add_argument("topic", help="a relative name follows ROS_NAMESPACE")
    options.add_argument("--timeout", type=float, default=5.0, metavar="SECONDS")
    options.add_argument("--all", action="store_true", help="print all messages, until standard input ends")
    asked = options.parse_args()
    if "AMENT_PREFIX_PATH" not in os.environ:
        environment = adopted(Path("/proc"))
        if environment:
            # The libraries of ROS are found by LD_LIBRARY_PATH, which counts only at the start of a program.
            command = (
                Path("/proc/self/cmdline").read_bytes().split(b"\0")[:-1]
            )  # with -c, sys.argv lacks the program
            os.execve(sys.executable, command, {**environment, **overruled()})  # noqa: S606  no shell is wanted
    if asked.all:
        end_with_input()
    topic = resolved(asked.topic, os.environ.get("ROS_NAMESPACE", ""))
    try:
        on_message = show if asked.all else lambda _: False
        listen(topic, timeout=asked.timeout, every=asked.all, on_message=on_message)
    except NoMessage as problem:
        sys.stdout.write(f"{topic}: {problem}\n")
        return {NoRos: NO_ROS, NotPublished: UNPUBLISHED}.get(type(problem), 1) if asked.all else 1
    except Exception as problem:  # noqa: BLE001  Docker shows one line of a check, and a traceback has more
        sys.stdout.write(f"{topic}: {type(problem).__name__}: {str(problem).partition(chr(10))[0]}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
