"""Which topics does a robot publish, as seen from a desktop without ROS?"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from fleet.errors import RobotError
from fleet.ros import listen, listen_ros2, silence, tcpros
from fleet.ros.rtps_discovery import ros_type

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.inventory import Robot
    from fleet.ros.listen_ros2 import Listener, OnRobot
    from fleet.ros.rtps_graph import Graph

STARTING = 1.0
"""Seconds from a subscription to the first message, at most: they are not a pause."""

AT_ONCE = 32
"""Topics of one robot with ROS 1 that are measured side by side, each in a thread and over a connection."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A topic: its type as ROS writes it, "" if the master does not know it, how many publish it, and how many want it.

    ``quality``: what its publishers of ROS 2 offer. ``unmatched``: why subscribers of the robot get no message of it.
    ``rate``: messages in a second, None if that was not measured.
    """

    name: str
    type: str
    publishers: int
    subscribers: int = 0
    quality: str = ""
    unmatched: tuple[str, ...] = ()
    rate: float | None = None


def topics(robot: Robot, *, timeout: float, on_robot: OnRobot, measure: float = 0) -> tuple[Topic, ...]:
    """Return the topics of a robot, by name; with ROS 1 those of its master.

    ``timeout``: seconds to find the nodes of ROS 2. ``measure``: seconds to count messages, 0 for none. Raises `RobotError` if
    there is no master, or if no node is found.
    """
    if robot.ros.version == 2:
        return _of_nodes(robot, timeout=timeout, on_robot=on_robot, measure=measure)
    found = _of_master(robot)
    if not measure:
        return found
    with ThreadPoolExecutor(AT_ONCE) as pool:
        rates = pool.map(partial(_rate, robot, measure=measure), [topic.name for topic in found])
        return tuple(replace(topic, rate=rate) for topic, rate in zip(found, rates, strict=True))


def _of_master(robot: Robot) -> tuple[Topic, ...]:
    master, graph = listen.master_graph(robot)
    try:
        answer = tcpros.call(master, "getTopicTypes", deadline=time.monotonic() + listen.STEP)
    except tcpros.GraphError as problem:
        raise listen.no_master(problem, robot=robot, master=master) from problem
    pairs = answer if isinstance(answer, list) else []
    types = {str(pair[0]): str(pair[1]) for pair in pairs if isinstance(pair, list) and len(pair) == 2}
    return tuple(
        Topic(
            name=name,
            type=types.get(name, ""),
            publishers=len(nodes),
            subscribers=len(graph.subscribers.get(name, ())),
        )
        for name, nodes in sorted(graph.publishers.items())
    )


def _rate(robot: Robot, topic: str, *, measure: float) -> float | None:
    """Count the messages of one publisher. None if it cannot be reached: `fab listen` tells why."""
    times: list[float] = []
    with contextlib.suppress(RobotError), contextlib.closing(listen.stream_of(robot, topic)) as stream:
        end = time.monotonic() + measure
        with contextlib.suppress(tcpros.GraphError):
            while (left := end - time.monotonic()) > 0:
                stream.read(left)
                times.append(time.monotonic())
        return per_second(times, measure)
    return None


def per_second(times: list[float], measured: float) -> float:
    """Return the rate of messages that came at these times, in a measurement of so many seconds.

    Messages that come regularly are counted from the first to the last. If all of them came in a part of the time, they are
    a burst, and the pauses before and after it count.
    """
    span = times[-1] - times[0] if times else 0.0
    regular = span > 0 and measured - span < 2 * span / (len(times) - 1) + STARTING
    return (len(times) - 1) / span if regular else len(times) / measured


def _of_nodes(robot: Robot, *, timeout: float, on_robot: OnRobot, measure: float) -> tuple[Topic, ...]:
    if robot.ros.rmw == "rmw_zenoh_cpp":
        raise silence.by_zenoh(robot)
    addresses = listen_ros2.addresses_of(robot, on_robot)
    with listen_ros2.Listener(robot, "", addresses, counting=True) as listener:
        began = time.monotonic()
        while time.monotonic() - began < timeout and not listener.settled:
            listener.announce(every=listen_ros2.REPEAT)
            for _ in listener.receive():
                pass  # nothing is followed yet
        if not listener.graph.writers:
            network = listen_ros2.network_of(on_robot)
            raise silence.reason(robot, listener.graph, network, heard=0, timeout=timeout)
        return of_graph(listener.graph, rates=_rates(listener, measure) if measure else {})


def _rates(listener: Listener, measure: float) -> dict[str, float]:
    """Count the messages of all topics, by their DDS names."""
    times: dict[str, list[float]] = {
        writer.topic: [] for writer in listener.graph.writers.values() if writer.topic[:3] == "rt/"
    }
    listener.follow(times)
    end = time.monotonic() + measure
    while time.monotonic() < end:
        listener.announce(every=listen_ros2.REPEAT)
        for arrival in listener.receive():
            times[arrival.message.topic].append(arrival.monotonic)
    return {topic: per_second(found, measure) for topic, found in times.items()}


def of_graph(graph: Graph, *, rates: Mapping[str, float]) -> tuple[Topic, ...]:
    """Return the topics of a robot's publishers, without services, actions and programs that are not ROS's."""
    writers = [writer for writer in graph.writers.values() if writer.topic[:3] == "rt/"]
    found = Counter((writer.topic, writer.type) for writer in writers)
    return tuple(
        Topic(
            name=topic[2:],
            type=ros_type(kind),
            publishers=count,
            subscribers=sum(reader.topic == topic for reader in graph.readers.values()),
            quality="; ".join(
                sorted(
                    {
                        str(writer.quality)
                        for writer in writers
                        if (writer.topic, writer.type) == (topic, kind)
                    }
                )
            ),
            unmatched=graph.unmatched(topic),
            rate=rates.get(topic),
        )
        for (topic, kind), count in sorted(found.items())
    )
