"""Has a robot come up, and is its first boot over?

A robot is looked for where the inventory says, then by its name in the local network (mDNS), then among the desktop's
neighbours by its recorded host key: its router may have given it another address.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from fleet.card import first_boot
from fleet.errors import FleetError, LinkLost, LoginRefused, NotReady, Unreachable, UsageError
from fleet.plan.outcome import Outcome
from fleet.rollout import sighting
from fleet.rollout.pool import each
from fleet.ssh import mdns, neighbours

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fleet.config.inventory import Robot
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress
    from fleet.rollout.sighting import Sighting

COME_UP = "wait until it has come up"
FINISH = "wait until its first boot is over"

_PAUSE = 3.0
"""Seconds between two attempts."""

_LOOK_AROUND = 20.0
"""Seconds between two looks at the neighbours. OpenSSH blocks an address that only connects for some seconds each time
(PerSourcePenalties in sshd_config(5)), and two connections in this time are forgotten again."""

_CLOUD_INIT = "command -v cloud-init >/dev/null || exit 0; exec cloud-init status --wait --long"


def wait(
    robots: Sequence[Robot], *, timeout: float, scan: bool = False, progress: Progress
) -> tuple[Outcome, ...]:
    """Wait at most ``timeout`` seconds until each robot lets us in and its first boot is over.

    With ``scan``, each address of the desktop's networks is tried too, now and then, for a robot that is not found.
    """
    deadline = time.monotonic() + timeout
    progress.announce([robot.name for robot in robots], COME_UP)
    search = partial(elsewhere, scan=scan)
    return each(
        robots,
        lambda link: _one(link, deadline=deadline, progress=progress, search=search),
        progress=progress,
    )


def elsewhere(robot: Robot, *, name: str, scan: bool = False) -> Sighting | None:
    """Look for a robot at other addresses. Only its recorded host key counts."""
    register = sighting.register((robot,))
    if not register.keys:
        return None
    named = mdns.addresses(name) if name else ()
    around = neighbours.swept() if scan else neighbours.known()
    addresses = [one for one in (*named, *around) if one not in register.addresses]
    found = [
        sighting.Candidate(address=address, name=name if address in named else "")
        for address in neighbours.greetings(addresses)
    ]
    return next(
        (one for one in sighting.sight(found, like=robot, register=register) if one.moved),
        None,
    )


def _one(
    link: Link, *, deadline: float, progress: Progress, search: Callable[..., Sighting | None]
) -> Outcome:
    robot = link.robot
    progress.step_started(robot.name, COME_UP, None)
    if there := _come_up(link, deadline=deadline, search=search):
        return _moved(robot, there)
    progress.step_started(robot.name, FINISH, None)
    done = link.session.run(("sh", "-c", _CLOUD_INIT), limit=max(30.0, deadline - time.monotonic()))
    if done.code not in (0, 2):  # 2: it went on in spite of warnings
        lines = [line.strip("- \t") for line in done.output.splitlines()]
        reason = next(filter(None, reversed(lines)), "no reason given")
        raise NotReady(
            f"cloud-init failed at its first boot: {reason}",
            cure="`fab run -- cloud-init status --long` shows more; correct the card with `fab card`",
        )
    warned = ", with warnings: `fab run -- cloud-init status --long`" if done.code else ""
    return Outcome(robot=robot.name, status="done", summary=f"it is up{warned}")


def _come_up(link: Link, *, deadline: float, search: Callable[..., Sighting | None]) -> Sighting | None:
    """Wait until a robot lets us in. Returns where it is instead, if it is elsewhere."""
    name, looked = _announced(link.robot), -_LOOK_AROUND
    while True:
        try:
            link.session  # noqa: B018  it connects
        except (Unreachable, LoginRefused, LinkLost, NotReady) as problem:
            if link.closed.is_set():
                raise
            late = time.monotonic() >= deadline
            if late or time.monotonic() - looked >= _LOOK_AROUND:
                looked = time.monotonic()
                if there := search(link.robot, name=name):
                    return there
            if late:
                raise _late(problem) from None
            link.closed.wait(min(_PAUSE, max(0.0, deadline - time.monotonic())))
        else:
            return None


def _announced(robot: Robot) -> str:
    try:
        return f"{first_boot.hostname(robot)}.local"
    except UsageError:
        return ""


def _moved(robot: Robot, there: Sighting) -> Outcome:
    at = there.candidate.address
    cure = (
        f"write `address: {at}` into the inventory, then `fab trust --hosts {robot.name}` shows the same key"
    )
    if robot.address.endswith(".local") and not neighbours.resolved(robot.address):
        cure = f"this computer resolves no .local names: install libnss-mdns, or {cure}"
    return Outcome(
        robot=robot.name,
        status="failed",
        reason=f"it is up at {at}, by its host key, and not at {robot.address}",
        cure=cure,
    )


def _late(problem: FleetError) -> FleetError:
    cure = "see whether it has power, and whether its Wi-Fi is right; `fab find --scan` looks for it at every address"
    return type(problem)(f"it has not come up: {problem.what}", cure=cure)
