"""Which verbs does ``fab`` have? Each selects robots, asks another module for a plan, and shows or applies it.

What takes long to import (the Docker SDK) is imported where it is used, so that ``fab --list`` stays quick.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from fleet import build as builds
from fleet import cli, containers, image, labtasks, script, sshconfig
from fleet import follow as following
from fleet import inventory as inventories
from fleet import provision as provisioning
from fleet import release as releases
from fleet import ship as shipping
from fleet import status as states
from fleet import trust as trusting
from fleet.cli import verb
from fleet.console import Screen, Silence
from fleet.dockercli import buildkit_client
from fleet.errors import Mistake
from fleet.execute import execute, keep_observing, observe, whoami

if TYPE_CHECKING:
    from fleet.facts import Facts
    from fleet.inventory import Inventory, Robot
    from fleet.plan import Plan


@verb()
def inventory(hosts: str = "all", json: bool = False, inventory: str = "") -> None:
    """Show each robot as defaults, groups and its own values make it."""
    screen, robots = Screen(), _select(inventory, hosts)[1]
    if json:
        screen.json([robot.model_dump(mode="json") for robot in robots])
    else:
        screen.records({robot.name: robot.model_dump(mode="json", exclude_none=True) for robot in robots})


@verb({"yes": "record without asking", "changed": "also replace keys that have changed"})
def trust(
    hosts: str = "all",
    yes: bool = False,
    changed: bool = False,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
) -> int:
    """Show the robots' host keys and record them; every other verb refuses unknown and changed keys."""
    screen, robots = Screen(), _select(inventory, hosts)[1]
    with screen.progress() as show:
        offers, missing = trusting.look(robots, watch=show)
    new = trusting.to_record(offers, changed=changed)
    for offer in new:
        screen.say(offer.text())
    if dry or not new or not (yes or screen.confirm(f"Record {len(new)} host keys?")):
        new = ()
    trusting.record(new)
    outcomes = (*(trusting.outcome(offer, recorded=offer in new) for offer in offers), *missing)
    return screen.result(outcomes, json=json)


@verb()
def provision(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Make robots ready: Docker by its convenience script, Compose, log limits, the login's right to use it."""
    fleet, robots = _select(inventory, hosts)
    wanted = {robot.docker for robot in robots}
    scripts = {d: script.fetch(d.script, sha256=d.sha256, base=fleet.path.parent) for d in wanted}

    def make(robot: Robot, facts: Facts) -> Plan:
        return provisioning.plan(
            robot=robot, facts=facts, script=scripts[robot.docker], now=time.time(), by=whoami()
        )

    return execute(robots, make, dry=dry, json=json, screen=Screen())


@verb()
def build(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> None:
    """Build the stack's images for the platforms of the robots."""
    fleet, robots = _select(inventory, hosts)
    screen, stack = Screen(), releases.read_stack(fleet.stack)
    platforms = tuple(dict.fromkeys(robot.platform for robot in robots))
    commands = builds.plan(stack=stack, platforms=platforms, client=buildkit_client())
    if dry:
        screen.json(commands) if json else screen.lines(builds.lines(commands))
        return
    for command in commands:
        builds.run(command, say=screen.say)
    with image.Store() as store:
        found = [store.find(name, platform) for platform in platforms for name in stack.images.values()]
    screen.images(found, json=json)


@verb()
def ship(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Send the stack's images and each robot's release, start it, and wait until it is healthy."""
    fleet, robots = _select(inventory, hosts)
    stack = releases.read_stack(fleet.stack)
    with image.Store() as store:
        composed = {robot: releases.compose(robot=robot, stack=stack, find=store.find) for robot in robots}

        def make(robot: Robot, facts: Facts) -> Plan:
            return shipping.plan(robot=robot, release=composed[robot], facts=facts, by=whoami())

        return execute(robots, make, dry=dry, json=json, screen=Screen(), open_feed=store.open)


@verb({"to": "the release to go back to; default: the one that ran before"})
def rollback(
    hosts: str = "all", to: str = "", dry: bool = False, json: bool = False, inventory: str = ""
) -> int:
    """Go back to the release that ran before, or to another one that the robot still has."""

    def make(robot: Robot, facts: Facts) -> Plan:
        return shipping.rollback(robot=robot, facts=facts, to=to, by=whoami())

    return execute(_select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen())


@verb()
def start(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Start the current release and wait until it is healthy."""
    return _contain("start", hosts=hosts, dry=dry, json=json, inventory=inventory)


@verb()
def stop(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Stop the current release; it stays stopped over a reboot."""
    return _contain("stop", hosts=hosts, dry=dry, json=json, inventory=inventory)


@verb()
def restart(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Restart the current release and wait until it is healthy."""
    return _contain("restart", hosts=hosts, dry=dry, json=json, inventory=inventory)


@verb({"watch": "keep the table up to date, until Ctrl-C"})
def status(hosts: str = "all", watch: bool = False, json: bool = False, inventory: str = "") -> int:
    """Show each robot: reachable, release, containers and their health, Docker, disk, temperature."""
    screen, robots = Screen(), _select(inventory, hosts)[1]
    seen = observe(robots, watch=Silence())
    if json:
        screen.json({name: states.record(what) for name, what in seen.items()})
    elif watch:
        with screen.live(states.COLUMNS, lambda: [states.row(name, what) for name, what in seen.items()]):
            keep_observing(robots, seen, every=2.0, watch=Silence())
    else:
        screen.table(states.COLUMNS, [states.row(name, what) for name, what in seen.items()])
    return 0 if watch or all(states.good(what) for what in seen.values()) else 1


@verb({"tail": "events to show of each robot; default: 10"})
def history(hosts: str = "all", tail: int = 10, json: bool = False, inventory: str = "") -> int:
    """Show who shipped what to each robot, when, and what came of it."""
    screen, robots = Screen(), _select(inventory, hosts)[1]
    seen = observe(robots, watch=Silence())
    events = {name: states.events(what)[-tail:] for name, what in seen.items()}
    if json:
        screen.json(events)
    else:
        screen.table(
            states.EVENT_COLUMNS, [states.event_row(name, e) for name in events for e in events[name]]
        )
    return screen.problems(states.problems(seen))


@verb(
    {
        "follow": "go on with what they say from now on, until Ctrl-C",
        "tail": "lines from the end of each container's log, or all; default: 20",
        "since": "only what was said since then: 10m, 2h, 2026-11-23T12:00:00",
        "service": "only this service of the stack",
    }
)
def logs(
    hosts: str = "all",
    follow: bool = False,
    tail: str = "20",
    since: str = "",
    service: str = "",
    inventory: str = "",
) -> int:
    """Show what the robots' containers say, merged, each line with its robot's name."""
    screen, robots = Screen(), _select(inventory, hosts)[1]
    printer = screen.prefixed([robot.name for robot in robots])

    def argv(robot: Robot, facts: Facts) -> tuple[str, ...]:
        return containers.logs(
            robot=robot, facts=facts, follow=follow, tail=tail, since=since, service=service
        )

    return screen.problems(following.logs(robots, argv, follow=follow, printer=printer, watch=Silence()))


@verb(
    {
        "command": "a line for the robots' shell; also after --",
        "limit": "seconds it may take, 0: any; default: 60",
    },
    positional="command",
)
def run(command: str = "", hosts: str = "all", limit: int = 60, inventory: str = "") -> int:
    """Run a command on robots: fab run --hosts fleet -- uptime."""
    if not command:
        raise Mistake("there is no command to run", cure="fab run --hosts NAMES -- COMMAND")
    screen, robots = Screen(), _select(inventory, hosts)[1]
    printer = screen.prefixed([robot.name for robot in robots])
    return screen.problems(following.run(robots, command, limit=limit, printer=printer, watch=Silence()))


@verb({"hosts": "one robot"})
def shell(hosts: str, inventory: str = "") -> None:
    """Log in to one robot, with OpenSSH and the keys recorded by `fab trust`."""
    robots = _select(inventory, hosts)[1]
    if len(robots) != 1:
        raise Mistake(
            f"a shell goes to one robot, and {hosts} names {len(robots)}", cure="fab shell --hosts NAME"
        )
    argv = sshconfig.login(robots[0])
    os.execvp(argv[0], argv)  # noqa: S606  the terminal becomes ssh's


@verb(
    {
        "topic": "the topic; default: /time",
        "count": "messages from each robot, 0: until Ctrl-C; default: 0",
        "timeout": "seconds of silence that are a failure; default: 10",
    }
)
def listen(
    hosts: str = "all", topic: str = "/time", count: int = 0, timeout: int = 10, inventory: str = ""
) -> int:
    """Show a topic's messages from each robot as they arrive here, or say why they do not."""
    screen, robots = Screen(), _select(inventory, hosts)[1]
    printer = screen.prefixed([robot.name for robot in robots])
    return screen.problems(
        following.topics(robots, topic, count=count, timeout=timeout, printer=printer, watch=Silence())
    )


ns = cli.collection(
    (
        inventory,
        trust,
        provision,
        build,
        ship,
        rollback,
        history,
        start,
        stop,
        restart,
        status,
        logs,
        run,
        shell,
        listen,
    ),
    lab=labtasks.VERBS,
)


def main() -> None:
    """The ``fleet`` command: the same verbs, for a folder that has an inventory and no fabfile."""
    cli.main(ns)


def _select(inventory: str, hosts: str) -> tuple[Inventory, tuple[Robot, ...]]:
    """The inventory and the robots that ``--hosts`` means."""
    fleet = inventories.load(_inventory_file(inventory or os.environ.get("FLEET_INVENTORY", "")))
    return fleet, fleet.select(hosts)


def _inventory_file(said: str) -> Path:
    """What was said, else the nearest ``inventory.yaml`` from here upwards: ``fab`` works in subfolders."""
    if said:
        return Path(said)
    usual = Path("inventory.yaml")
    return next(
        (path for folder in (Path(), *Path.cwd().parents) if (path := folder / usual).exists()), usual
    )


def _contain(verb: containers.Verb, *, hosts: str, dry: bool, json: bool, inventory: str) -> int:
    def make(robot: Robot, facts: Facts) -> Plan:
        return containers.plan(verb, robot=robot, facts=facts, by=whoami())

    return execute(_select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen())
