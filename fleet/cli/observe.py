"""Which verbs look at robots without changing what they run?"""

from __future__ import annotations

import os
import shlex
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

from fleet.cli import heard, whose
from fleet.cli import status as states
from fleet.cli.console import Screen
from fleet.cli.selection import select
from fleet.cli.stacks import stacks_there
from fleet.cli.verb import verb
from fleet.errors import FleetError, UsageError
from fleet.plan import containers
from fleet.rollout import listening, stream, topic_list
from fleet.rollout.observe import keep_observing, observe
from fleet.rollout.progress import NoProgress
from fleet.ros import listen_ros2
from fleet.ssh import openssh_config

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from fleet.rollout.listening import Show
    from fleet.ros.topics import Topic

MEASURED = 5.0
"""Seconds for which `fab topics --rate` counts messages."""


@verb({"facts": "ask the robots too: board, system, Docker, runtimes, devices"}, looks=True)
def inventory(hosts: str = "all", facts: bool = False, json: bool = False, inventory: str = "") -> int:
    """Show each robot with its merged settings.

    A robot's own settings override those of its groups, and those override the defaults. With --facts, the robots are
    asked what they are and have, such as the devices that are plugged in.
    """
    screen, robots = Screen(), select(inventory, hosts)[1]
    for one, other in whose.twins(robots):
        screen.say(f"{one} and {other} have the same address: `fab ship` refuses them")
    seen = observe(robots, progress=NoProgress()) if facts else {}
    if json:
        merged = [robot.model_dump(mode="json") for robot in robots]
        screen.json(
            [{**one, "facts": states.record(seen[one["name"]])} for one in merged] if facts else merged
        )
        return 0 if all(not isinstance(what, FleetError) for what in seen.values()) else 1
    told = {
        name: {"facts": states.described(what)}
        for name, what in seen.items()
        if not isinstance(what, FleetError)
    }
    screen.records({robot.name: {**_settings(robot), **told.get(robot.name, {})} for robot in robots})
    return screen.problems(states.problems(seen))


def _settings(robot: Robot) -> dict[str, Any]:
    """The settings of a robot that say something."""
    unused = {"ros": {"master"}} if robot.ros.version == 2 else {}
    settings: dict[str, Any] = robot.model_dump(mode="json", exclude_none=True, exclude=unused)
    settings["hardware"] = {key: value for key, value in settings["hardware"].items() if value}
    return {key: value for key, value in settings.items() if key not in ("peers", "hardware") or value}


@verb({"watch": "update the table until Ctrl-C"}, looks=True)
def status(hosts: str = "all", watch: bool = False, json: bool = False, inventory: str = "") -> int:
    """Show release, health, Docker, disk, temperature.

    Robots are shown as they answer, and those that do not answer at the end. The exit code is 0 if every robot answers
    and all its containers are healthy.
    """
    screen, robots = Screen(), select(inventory, hosts)[1]
    seen: dict[str, Facts | FleetError] = {}
    names = [robot.name for robot in robots]
    if watch and not json:
        with screen.live(states.COLUMNS, lambda: states.table(names, seen)):
            keep_observing(robots, seen, every=2.0, progress=NoProgress())
    elif json:
        observe(robots, progress=NoProgress(), seen=seen)
        screen.json({name: states.record(seen[name]) for name in names})
    else:
        arrivals = states.Arrivals(names, seen)
        with screen.growing(states.COLUMNS, arrivals.rows):
            observe(robots, progress=NoProgress(), seen=seen)
            arrivals.over = True
        screen.say(states.total(seen))
    for line in states.reboots(seen):
        screen.say(line)
    same = whose.same_computers({name: seen[name] for name in names if name in seen})
    for one, other in same:
        screen.say(f"{one} and {other} are the same computer: correct an address in the inventory")
    return 0 if watch or (not same and all(states.good(what) for what in seen.values())) else 1


@verb({"tail": "events to show for each robot; default: 10"}, looks=True)
def history(hosts: str = "all", tail: int = 10, json: bool = False, inventory: str = "") -> int:
    """Show who shipped what, when, and the outcome.

    Each robot keeps its history in ~/.fleet/stacks/NAME/history.
    """
    screen, robots = Screen(), select(inventory, hosts)[1]
    seen = observe(robots, progress=NoProgress())
    events = {name: states.events(what)[-tail:] if tail else () for name, what in seen.items()}
    if json:
        screen.json(
            {
                name: [{"stack": stack, **asdict(event)} for stack, event in found]
                for name, found in events.items()
            }
        )
    else:
        screen.table(
            states.EVENT_COLUMNS,
            [states.event_row(name, stack, event) for name in events for stack, event in events[name]],
        )
    return screen.problems(states.problems(seen))


@verb(
    {
        "follow": "keep printing new lines until Ctrl-C",
        "tail": "lines to show from the end of each container's log, or all; default: 20",
        "since": "show only lines since this time: 10m, 2h, 2026-11-23T12:00:00",
        "service": "show only this service of the stack",
    },
    looks=True,
)
def logs(
    hosts: str = "all",
    follow: bool = False,
    tail: str = "20",
    since: str = "",
    service: str = "",
    inventory: str = "",
    stack: str = "",
) -> int:
    """Show the logs of the robots' containers.

    The lines of all robots are merged. Each line begins with the robot's name.
    """
    screen, robots = Screen(), select(inventory, hosts)[1]
    printer = screen.prefixed([robot.name for robot in robots])

    def argv(robot: Robot, facts: Facts) -> tuple[str, ...]:
        (name,) = stacks_there(facts, only=stack, alone=True)
        return containers.logs(
            robot=robot, stack=name, facts=facts, follow=follow, tail=tail, since=since, service=service
        )

    return screen.problems(stream.logs(robots, argv, follow=follow, printer=printer, progress=NoProgress()))


@verb(
    {
        "command": "a shell command; it can also follow after --",
        "limit": "seconds before the command is stopped, 0 for no limit; default: 60",
    }
)
def run(
    command: str = "", hosts: str = "all", limit: int = 60, dry: bool = False, inventory: str = ""
) -> int:
    """Run a command on robots: fab run -- uptime.

    The robot's shell runs the command as the login user. The exit code is 1 if the command fails on any robot.
    """
    if not command:
        raise UsageError("no command was given", cure="fab run --hosts NAMES -- COMMAND")
    screen, robots = Screen(), select(inventory, hosts)[1]
    if dry:
        screen.lines(f"{robot.name}: $ {command}" for robot in robots)
        return 0
    printer = screen.prefixed([robot.name for robot in robots])
    return screen.problems(stream.run(robots, command, limit=limit, printer=printer, progress=NoProgress()))


@verb({"hosts": "one robot"})
def shell(hosts: str = "all", dry: bool = False, inventory: str = "") -> None:
    """Log in to one robot.

    It uses OpenSSH and the host keys that `fab trust` recorded.
    """
    robots = select(inventory, hosts)[1]
    if len(robots) != 1:
        raise UsageError(
            f"`fab shell` opens one robot, but {hosts} names {len(robots)}", cure="fab shell --hosts NAME"
        )
    argv = openssh_config.login(robots[0])
    if dry:
        Screen().lines([shlex.join(argv)])
        return
    os.execvp(argv[0], argv)  # noqa: S606  the terminal becomes ssh's


@verb(
    {
        "topic": "the topic to listen to; default: /time",
        "count": "messages, or measurements, to show from each robot, 0 for all until Ctrl-C; default: 0",
        "timeout": "fail after this many seconds without a message; default: 10",
        "rate": "show once a second how many messages arrive, and how large they are",
        "delay": "show once a second how old messages are when they arrive, by the stamp in their header",
        "via": "robot: listen in a container of the robot, over SSH, if this computer cannot reach its nodes",
        "json": "print each message as one line of JSON",
    },
    looks=True,
)
def listen(
    hosts: str = "all",
    topic: str = "/time",
    count: int = 0,
    timeout: int = 10,
    rate: bool = False,
    delay: bool = False,
    via: str = "",
    json: bool = False,
    inventory: str = "",
) -> int:
    """Show a topic's messages as they arrive here.

    This computer does not need ROS. If no message arrives, the reason is shown: a name that does not resolve, a loopback
    address, a closed port, or a topic without messages; for ROS 2 also another domain, a container with a network of its
    own, a firewall, and the settings of discovery. Subscribers on the robot that do not match the publisher are named.
    """
    _some_time(timeout)
    if via not in ("", "robot"):
        raise UsageError(f"--via {via} is not possible", cure="say --via robot, or leave it out")
    screen, robots = Screen(), select(inventory, hosts)[1]
    printer = screen.prefixed([robot.name for robot in robots])
    show: Show
    if rate or delay:
        on_report = heard.report_as_json(topic, screen.json_line) if json else heard.report_as_text(printer)
        show = heard.Measured(topic, delay=delay, on_report=on_report).show
    else:
        show = heard.as_json(topic, screen.json_line) if json else heard.as_text(printer)
    request = listening.Request(
        topic=topic, count=count, timeout=timeout, via_robot=via == "robot", clocks=delay
    )
    notes = partial(_note, screen)
    return screen.problems(listening.hear(robots, request, show=show, notes=notes, progress=NoProgress()))


def _some_time(timeout: int) -> None:
    if timeout < 1:
        raise UsageError(
            "--timeout 0 leaves no time to find anything", cure="say --timeout 10, or leave it out"
        )


def _note(screen: Screen, robot: str, text: str) -> None:
    screen.say(f"{robot}: {text}")


@verb(
    {
        "timeout": "seconds to look for the topics of a robot with ROS 2; default: 10",
        "rate": f"count the messages of all topics for {MEASURED:g} seconds; all of them are sent to this computer then",
    },
    looks=True,
)
def topics(
    hosts: str = "all", timeout: int = 10, rate: bool = False, json: bool = False, inventory: str = ""
) -> int:
    """List topics, their types, and how many publish them.

    For ROS 1, the topics are those of the robot's master. For ROS 2, they are those of the robot's own nodes, with the
    quality of service that their publishers offer; subscribers that do not match are named. If no topics are found, the
    reason is shown, as by `fab listen`.
    """
    _some_time(timeout)
    screen, robots = Screen(), select(inventory, hosts)[1]
    found, outcomes = topic_list.look(
        robots, timeout=timeout, measure=MEASURED if rate else 0, progress=NoProgress()
    )
    if json:
        screen.json({name: [asdict(topic) for topic in topics] for name, topics in found.items()})
    else:
        rows = [(name, one) for name, topics in found.items() for one in topics]
        screen.table(
            ("robot", "topic", "type", "publishers", "subscribers", "quality", *["messages/s"] * rate),
            [_topic_row(name, one, rate=rate) for name, one in rows],
        )
        for name, one in rows:
            for reason in one.unmatched:
                screen.say(f"{name}: {listen_ros2.unmatched(one.name, name, reason)}")
    return screen.problems(outcomes)


def _topic_row(robot: str, topic: Topic, *, rate: bool) -> list[tuple[str, str]]:
    # A topic with a message in ten seconds may have had none in this time.
    shown = "?" if topic.rate is None else f"{topic.rate:.3g}" if topic.rate else f"<{1 / MEASURED:g}"
    measured = [shown] * rate
    cells = (topic.name, topic.type, str(topic.publishers), str(topic.subscribers), topic.quality, *measured)
    return [(robot, "bold"), *((cell, "") for cell in cells)]


VERBS = (inventory, status, history, logs, run, shell, listen, topics)
