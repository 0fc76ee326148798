"""Which verbs change robots? Each selects robots, asks another module for a plan, and shows or applies it."""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from fleet.cli import wanted, whose
from fleet.cli.console import Screen
from fleet.cli.execute import execute, whoami
from fleet.cli.registry_access import certificates, login_of
from fleet.cli.selection import select
from fleet.cli.stacks import stacks_there
from fleet.cli.verb import verb
from fleet.config import yamlfile
from fleet.errors import UsageError
from fleet.plan import containers, readiness
from fleet.plan import prune as prune_old
from fleet.plan import ship as shipping
from fleet.plan.compose_steps import Request
from fleet.provision import docker_script, registry_certs
from fleet.provision import steps as provisioning
from fleet.rollout import trust as trusting
from fleet.transfer.delivery import STRATEGIES
from fleet.transfer.rate_limit import RateLimiter, bytes_per_second
from fleet.transfer.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.cli.wanted import Wanted
    from fleet.config.inventory import Robot
    from fleet.plan.compose_steps import Conflict
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
    scripts = docker_script.Scripts(base=yamlfile.folder(fleet.path))

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        text = scripts.fetch(robot.docker) if provisioning.needs_script(facts) else b""
        plan = provisioning.plan(
            robot=robot,
            facts=facts,
            script=text,
            now=time.time(),
            by=whoami(),
            certificates=certificates(robot.registry),
        )
        return [plan]

    return execute(robots, make, dry=dry, json=json, screen=Screen())


@verb(
    {
        "limit": "highest upload rate of all robots together, per second, such as 8Mbit or 1MB",
        "retry_for": "seconds to retry a lost connection; default: 180",
        "keep": "releases to keep on each robot; default: 3",
        "wait": "seconds that containers may take to become healthy; default: 180 plus the longest start_period",
        "prefer": "whose version of a file wins that robot and desktop have both changed: robot or desktop",
        "renamed": "the robots were renamed in the inventory: go on though they were shipped under another name",
        "from": "ship what CI built: a bundle (folder or tar archive), or images of a registry, NAME@sha256:... (commas)",
    }
)
def ship(
    hosts: str = "all",
    limit: str = "",
    retry_for: int = 180,
    keep: int = prune_old.KEEP,
    wait: int = 0,
    prefer: str = "robot",
    renamed: bool = False,
    from_: str = "",
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
    stack: str = "",
) -> int:
    """Send what is missing of the images, and start them.

    Each robot swaps the containers by itself and watches them; if they do not run, it goes back to the release before.
    If the connection drops, the transfer resumes where it stopped. A second run changes nothing.
    """
    fleet, robots = select(inventory, hosts)
    screen = Screen()
    whose.once(robots, among=fleet.robots.values())
    options = Options(
        run=secrets.token_hex(8), wait=wait, conflict=_conflict(prefer), keep=keep, renamed=renamed
    )
    limiter = RateLimiter(bytes_per_second(limit))
    with (
        wanted.opened(robots, out_of=from_, only=stack, screen=screen, dry=dry) as (source, releases),
        Sender.using(source, limiter=limiter, by=whoami(), logins=login_of) as sender,
    ):
        planner = Planner(releases, sender, options)
        ladder = [partial(planner.plans, strategy=strategy) for strategy in STRATEGIES]
        go = partial(execute, robots, *ladder, open_feed=sender.open, images=True, retry_for=retry_for)
        return go(dry=dry, json=json, screen=screen)


@verb({"keep": "releases to keep on each robot; default: 3"})
def prune(
    hosts: str = "all",
    keep: int = prune_old.KEEP,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
    stack: str = "",
) -> int:
    """Remove old releases and their images.

    Only those that fleet made; the current release and the one before it always stay, and so does what the robots'
    containers have written.
    """

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        readiness.ready(facts, robot=robot)
        names = [name for name in facts.fleet.stacks if stack in ("", name)]
        return [prune_old.plan(robot=robot, facts=facts, stacks=names, keep=keep)]

    return execute(select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen(), images=True)


@verb({"to": "the release to go back to; default: the previous one"})
def rollback(
    hosts: str = "all",
    to: str = "",
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
    stack: str = "",
) -> int:
    """Go back to the previous release.

    With --to, go back to any release that is still on the robot. `fab history` lists releases. Data stays as it is.
    """
    run = secrets.token_hex(8)

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        readiness.ready(facts, robot=robot)
        names = stacks_there(facts, only=stack, alone=bool(to))
        plans = [
            shipping.rollback(robot=robot, stack=name, facts=facts, to=to, request=_plain(run))
            for name in names
        ]
        return _named(plans, names)

    return execute(select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen())


@verb()
def start(
    hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "", stack: str = ""
) -> int:
    """Start the current release.

    It waits until every container is healthy.
    """
    return _contain("start", hosts=hosts, dry=dry, json=json, inventory=inventory, stack=stack)


@verb()
def stop(
    hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "", stack: str = ""
) -> int:
    """Stop the current release.

    It stays stopped after a reboot, until `fab start` or the next `fab ship`.
    """
    return _contain("stop", hosts=hosts, dry=dry, json=json, inventory=inventory, stack=stack)


@verb()
def restart(
    hosts: str = "all", dry: bool = False, json: bool = False, inventory: str = "", stack: str = ""
) -> int:
    """Restart the current release.

    It waits until every container is healthy.
    """
    return _contain("restart", hosts=hosts, dry=dry, json=json, inventory=inventory, stack=stack)


@verb({"stack": "the stack to take off, by its name", "data": "delete its data too", "yes": "do not ask"})
def remove(
    stack: str = "",
    hosts: str = "all",
    data: bool = False,
    yes: bool = False,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
) -> int:
    """Take a stack off robots, and leave its data.

    It removes the stack's containers, networks and releases. What containers have written stays: the folder
    ~/.fleet/stacks/NAME/data and Docker's volumes. With --data the folder is deleted too, after a question.
    """
    if not stack:
        raise UsageError("which stack?", cure="fab remove --stack NAME; `fab status` shows the names")
    robots, screen = select(inventory, hosts)[1], Screen()
    question = f"Delete what stack {stack} has written on {', '.join(robot.name for robot in robots)}?"
    if data and not dry and not yes and not screen.confirm(question):
        raise UsageError("nothing was removed", cure="say --yes to delete without a question")

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        return [containers.remove(robot=robot, stack=stack, facts=facts, by=whoami(), data=data)]

    return execute(robots, make, dry=dry, json=json, screen=screen)


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a person asked of one `fab ship`, for all robots; ``run`` is a word of this run's own."""

    run: str
    wait: int
    conflict: Conflict
    keep: int
    renamed: bool

    def request(self, one: Wanted, *, way: str) -> Request:
        """How long a stack may take, who asks, and by which ``way`` its images come, if that is not SSH."""
        return Request(
            by=f"{whoami()} by {way}" if way else whoami(),
            run=self.run,
            wait=self.wait or one.wait,
            settle=one.settle,
            conflict=self.conflict,
        )


class Planner:
    """Plans the releases of one `fab ship` for each robot; called from many threads."""

    def __init__(self, releases: Mapping[str, Sequence[Wanted]], sender: Sender, options: Options) -> None:
        self._releases = releases
        self._sender = sender
        self._options = options
        self._machines = whose.Machines()

    def plans(self, robot: Robot, facts: Facts, *, strategy: Strategy) -> list[Plan]:
        """One plan for each of a robot's stacks. Raises `NotReady` if the robot cannot take one of them."""
        readiness.ready(facts, robot=robot)
        self._machines.claim(robot, facts, renamed=self._options.renamed)
        plans = []
        for one in self._releases[robot.name]:
            if one.project:
                whose.same_stack(one.project, facts, robot=robot)
            missing = shipping.missing(one.release, facts)
            if missing:
                registry_certs.check(robot, facts, certificates(robot.registry))
            delivery = self._sender.deliver(missing, robot=robot, facts=facts, strategy=strategy)
            plan = shipping.plan(
                robot=robot,
                release=one.release,
                facts=facts,
                delivery=delivery,
                request=self._options.request(one, way=delivery.way),
                keep=self._options.keep,
            )
            plans.append(plan)
        return _named(plans, [one.release.stack for one in self._releases[robot.name]])


VERBS = (trust, provision, ship, rollback, prune, start, stop, restart, remove)


def _contain(verb: containers.Verb, *, hosts: str, dry: bool, json: bool, inventory: str, stack: str) -> int:
    run = secrets.token_hex(8)

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        readiness.ready(facts, robot=robot)
        names = stacks_there(facts, only=stack)
        plans = [
            containers.plan(verb, robot=robot, stack=name, facts=facts, request=_plain(run)) for name in names
        ]
        return _named(plans, names)

    return execute(select(inventory, hosts)[1], make, dry=dry, json=json, screen=Screen())


def _plain(run: str) -> Request:
    return Request(by=whoami(), run=run)


def _conflict(word: str) -> Conflict:
    match word:
        case "robot" | "desktop":
            return word
        case _:
            raise UsageError(f"--prefer takes robot or desktop, not {word}")


def _named(plans: list[Plan], names: Sequence[str]) -> list[Plan]:
    """The plans of a robot with several stacks say which stack each is about."""
    if len(plans) < 2:
        return plans
    return [replace(plan, stack=name) for plan, name in zip(plans, names, strict=True)]
