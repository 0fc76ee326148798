"""Which topics does a robot publish, as seen from a desktop without ROS?"""

from __future__ import annotations

import re
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.ros import listen, listen_ros2, silence, tcpros

if TYPE_CHECKING:
    from collections.abc import Iterable

    from fleet.config.inventory import Robot
    from fleet.ros.listen_ros2 import OnRobot
    from fleet.ros.rtps import Writer

SETTLED = 2.0
"""Seconds without a new publisher after which all of them are known: participants announce themselves several times then."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A topic: its type as ROS writes it, "" if the master does not know it, and how many publish it."""

    name: str
    type: str
    publishers: int


def topics(robot: Robot, *, timeout: float, on_robot: OnRobot) -> tuple[Topic, ...]:
    """Return the topics of a robot, by name; with ROS 1 those of its master.

    ``timeout``: seconds to find the nodes of ROS 2. Raises `RobotError` if there is no master, or if no node is found.
    """
    return (
        _of_nodes(robot, timeout=timeout, on_robot=on_robot) if robot.ros.version == 2 else _of_master(robot)
    )


def _of_master(robot: Robot) -> tuple[Topic, ...]:
    master, graph = listen.master_graph(robot)
    try:
        answer = tcpros.call(master, "getTopicTypes", deadline=time.monotonic() + listen.STEP)
    except tcpros.GraphError as problem:
        raise listen.no_master(problem, robot=robot, master=master) from problem
    pairs = answer if isinstance(answer, list) else []
    types = {str(pair[0]): str(pair[1]) for pair in pairs if isinstance(pair, list) and len(pair) == 2}
    return tuple(
        Topic(name=name, type=types.get(name, ""), publishers=len(nodes))
        for name, nodes in sorted(graph.publishers.items())
    )


def _of_nodes(robot: Robot, *, timeout: float, on_robot: OnRobot) -> tuple[Topic, ...]:
    if robot.ros.rmw == "rmw_zenoh_cpp":
        raise silence.by_zenoh(robot)
    with listen_ros2.Listener(robot, "/", listen_ros2.addresses_of(robot, on_robot)) as listener:
        began = changed = time.monotonic()
        known = 0
        while (now := time.monotonic()) - began < timeout and not (known and now - changed > SETTLED):
            listener.announce(every=listen_ros2.REPEAT)
            for _ in listener.receive():
                pass  # nobody publishes a topic without a name
            if len(listener.graph.writers) != known:
                known, changed = len(listener.graph.writers), now
        if not known:
            network = listen_ros2.network_of(on_robot)
            raise silence.reason(robot, listener.graph, network, heard=0, timeout=timeout)
        return of_writers(listener.graph.writers.values())


def of_writers(writers: Iterable[Writer]) -> tuple[Topic, ...]:
    """Return the topics of publishers, without services, actions and programs that are not ROS's."""
    found = Counter((writer.topic[2:], _type(writer.type)) for writer in writers if writer.topic[:3] == "rt/")
    return tuple(
        Topic(name=name, type=kind, publishers=count) for (name, kind), count in sorted(found.items())
    )


def _type(dds: str) -> str:
    """Return ``std_msgs/msg/String`` for ``std_msgs::msg::dds_::String_``."""
    return re.sub(r"^(\w+)::(\w+)::dds_::(\w+)_$", r"\1/\2/\3", dds)
