"""Which verbs change robots? Each selects robots, asks another module for a plan, and prints or applies it."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from fleet.cli.console import Screen
from fleet.cli.execute import execute, whoami
from fleet.cli.selection import select
from fleet.cli.verb import verb
from fleet.config import stack as stack_module
from fleet.images import build as builds
from fleet.images import store as image
from fleet.images.docker_cli import buildkit_client
from fleet.plan import containers, readiness
from fleet.plan import prune as prune_old
from fleet.plan import ship as ship_module
from fleet.provision import docker_script, steps
from fleet.robot import release as release_module
from fleet.rollout import trust as trusting
from fleet.transfer.delivery import STRATEGIES
from fleet.transfer.rate_limit import RateLimiter, bytes_per_second
from fleet.transfer.sender import Sender

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.plan.step import Plan
    from fleet.robot.facts import Facts
    from fleet.transfer.delivery import Strategy


@verb({"yes": "record the keys without asking", "changed": "also replace recorded keys that have changed"})
def trust(
    hosts: str = "all",
    yes: bool = False,
    changed: bool = False,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
) -> int:
    """Show the robots' host keys and record them.

    Compare each fingerprint with the output of `ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub` on the robot. All
    other verbs refuse a robot whose key is unknown or has changed.
    """
    screen, robots = Screen(), select(inventory, hosts)[1]
    with screen.progress() as progress:
        offers, missing = trusting.offered_keys(robots, progress=progress)
    new = trusting.to_record(offers, changed=changed)
    for offer in new:
        screen.say(offer.text())
    if not dry:
        new = new if new and (yes or screen.confirm(f"Record {len(new)} host keys?")) else ()
        trusting.record(new)
    outcomes = (*(trusting.outcome(offer, recorded=offer in new, dry=dry) for offer in offers), *missing)
    return screen.result(outcomes, json=json)


@verb()
def provision(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Install Docker on robots and check that it works.

    It corrects the clock, runs Docker's convenience script, installs the Compose plugin, limits log sizes, lets the
    login user use Docker, and runs a test container. It skips each part that is already right.
    """
    fleet, robots = select(inventory, hosts)
    scripts = docker_script.Scripts(base=fleet.path.parent)

    def make(robot: Robot, facts: Facts) -> Plan:
        text = scripts.fetch(robot.docker) if steps.needs_script(facts) else b""
        return steps.plan(robot=robot, facts=facts, script=text, now=time.time(), by=whoami())

    return execute(robots, make, dry=dry, json=json, screen=Screen())


@verb()
def build(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> None:
    """Build the stack's images for the robots' platforms.

    Each image is tagged with its platform, such as talker:latest-arm64. Images of services without `build:` are pulled.
    """
    fleet, robots = select(inventory, hosts)
    screen, stack = Screen(), stack_module.read_stack(fleet.stack)
    platforms = tuple(dict.fromkeys(robot.platform for robot in robots))
    commands = builds.plan(stack=stack, platforms=platforms, client=buildkit_client())
    if dry:
        screen.json(commands) if json else screen.lines(builds.lines(commands))
        return
    for command in commands:
        builds.run(command, say=screen.say)
    with image.Store() as store:
        images = [store.find(name, platform) for platform in platforms for name in stack.images.values()]
    screen.images(images, json=json)


@verb(
    {
        "limit": "highest upload rate of all robots together, per second, such as 8Mbit or 1MB",
        "retry_for": "seconds to retry a lost connection; default: 180",
        "keep": "releases to keep on each robot; default: 3",
    }
)
def ship(
    hosts: str = "all",
    limit: str = "",
    retry_for: int = 180,
    keep: int = prune_old.KEEP,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
) -> int:
    """Send the missing parts of the images and start them.

    It waits until every container is healthy. If a container does not start, the previous release is started again. If
    the connection drops, the transfer resumes where it stopped. A second run changes nothing.
    """
    fleet, robots = select(inventory, hosts)
    stack = stack_module.read_stack(fleet.stack)
    pace = RateLimiter(bytes_per_second(limit))
    with image.Store() as store, Sender.using(store, limiter=pace, by=whoami()) as sender:
        composed = {
            robot: release_module.compose(robot=robot, stack=stack, find=store.find) for robot in robots
        }

        def make(robot: Robot, facts: Facts, *, way: Strategy) -> Plan:
            readiness.ready(facts, robot=robot)
            release = composed[robot]
            missing = ship_module.missing(release, facts)
            delivery = sender.deliver(missing, robot=robot, facts=facts, strategy=way)
            return ship_module.plan(
                robot=robot, release=release, facts=facts, delivery=delivery, by=whoami(), keep=keep
            )

        ladder = [partial(make, way=way) for way in STRATEGIES]
        run = partial(execute, robots, *ladder, open_feed=sender.open, images=True, retry_for=retry_for)
        return run(dry=dry, json=json, screen=Screen())


@verb({"keep": "releases to keep on each robot; default: 3"})
def prune(
    hosts: str = "all",
    keep: int = prune_old.KEEP,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
) -> int:
    """Remove old releases and their images.

    Only releases and images that fleet put there are removed. The current release and the previous one always stay.
    """

    def make(robot: Robot, facts: Facts) -> Plan:
        readiness.ready(facts, robot=robot)
        return prune_old.plan(robot=robot, facts=facts, keep=keep, by=whoami())

    return execute(select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen(), images=True)


@verb({"to": "the release to go back to; default: the previous one"})
def rollback(
    hosts: str = "all", to: str = "", dry: bool = False, json: bool = False, inventory: str = ""
) -> int:
    """Go back to the previous release.

    With --to, go back to any release that is still on the robot. `fab history` lists releases.
    """

    def make(robot: Robot, facts: Facts) -> Plan:
        return ship_module.rollback(robot=robot, facts=facts, to=to, by=whoami())

    return execute(select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen())


@verb()
def start(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Start the current release.

    It waits until every container is healthy.
    """
    return _contain("start", hosts=hosts, dry=dry, json=json, inventory=inventory)


@verb()
def stop(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Stop the current release.

    It stays stopped after a reboot, until `fab start` or the next `fab ship`.
    """
    return _contain("stop", hosts=hosts, dry=dry, json=json, inventory=inventory)


@verb()
def restart(hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "") -> int:
    """Restart the current release.

    It waits until every container is healthy.
    """
    return _contain("restart", hosts=hosts, dry=dry, json=json, inventory=inventory)


VERBS = (trust, provision, build, ship, rollback, prune, start, stop, restart)


def _contain(verb: containers.Verb, *, hosts: str, dry: bool, json: bool, inventory: str) -> int:
    def make(robot: Robot, facts: Facts) -> Plan:
        return containers.plan(verb, robot=robot, facts=facts, by=whoami())

    return execute(select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen())
