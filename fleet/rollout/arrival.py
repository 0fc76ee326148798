"""Has a robot come up, and is its first boot over?

A robot is looked for where the inventory says, then by its name in the local network (mDNS), then among the desktop's
neighbours by its recorded host key: its router may have given it another address.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from fleet.card import first_boot
from fleet.errors import (
    DesktopError,
    FleetError,
    LinkLost,
    LoginRefused,
    NotReady,
    RobotError,
    TimedOut,
    Unreachable,
    UntrustedHostKey,
    UsageError,
)
from fleet.plan.outcome import Outcome
from fleet.rollout import sighting
from fleet.rollout.pool import each
from fleet.ssh import neighbours

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

_LEAST = 30.0
"""Seconds that a first boot gets to end after a robot has come up at the last moment."""

_LOOK_AROUND = 20.0
"""Seconds between two looks at the neighbours. OpenSSH blocks an address that only connects for some seconds each time
(PerSourcePenalties in sshd_config(5)), and two connections in this time are forgotten again."""

_NOT_YET = (Unreachable, LoginRefused, LinkLost, TimedOut, NotReady)
"""What a robot that is coming up does: it does not answer, has no login yet, restarts, or is too busy for a command."""

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
    named = _named(name)
    around = neighbours.swept() if scan else neighbours.known()
    places = [(address, port) for port in register.ports for address in (*named, *around)]
    found = [
        sighting.Candidate(address=address, port=port, name=name if address in named else "")
        for address, port in neighbours.greetings(one for one in places if one not in register.places)
    ]
    return next(
        (one for one in sighting.sight(found, like=robot, register=register) if one.moved),
        None,
    )


def _named(name: str) -> tuple[str, ...]:
    from fleet.ssh import mdns  # noqa: PLC0415  zeroconf is a tenth of all imports, and most verbs do without

    try:
        return mdns.addresses(name) if name else ()
    except DesktopError:
        return ()  # then it is looked for among the neighbours only


def _one(
    link: Link, *, deadline: float, progress: Progress, search: Callable[..., Sighting | None]
) -> Outcome:
    robot = link.robot
    while True:
        progress.step_started(robot.name, COME_UP, None)
        if there := _come_up(link, deadline=deadline, search=search):
            return _moved(robot, there)
        progress.step_started(robot.name, FINISH, None)
        try:
            return _first_boot_over(link, limit=max(_LEAST, deadline - time.monotonic()))
        except _NOT_YET as problem:
            # It may restart in its first boot, or its Wi-Fi may go once more.
            _wait_on(link, problem, deadline=deadline, late=_not_over)
            link.reconnect()


def _first_boot_over(link: Link, *, limit: float) -> Outcome:
    robot = link.robot
    done = link.session.run(("sh", "-c", _CLOUD_INIT), limit=limit)
    if done.code == 1:
        lines = [line.strip("- \t") for line in done.output.splitlines()]
        reason = next(filter(None, reversed(lines)), "no reason given")
        raise _FirstBootFailed(
            f"cloud-init failed at its first boot: {reason}",
            cure=f"`fab run --hosts {robot.name} -- cloud-init status --long` shows more; write the card again, and correct it "
            f"with `fab card --hosts {robot.name}`",
        )
    if done.code not in (
        0,
        2,
    ):  # 2: it went on in spite of warnings; others: the command was ended, as by a restart
        raise LinkLost(f"the command that waits for its first boot ended with code {done.code}")
    more = f"`fab run --hosts {robot.name} -- cloud-init status --long`"
    return Outcome(
        robot=robot.name, status="done", summary=f"it is up{f', with warnings: {more}' if done.code else ''}"
    )


class _FirstBootFailed(RobotError):
    """cloud-init has ended with an error: to wait does not help."""


def _come_up(link: Link, *, deadline: float, search: Callable[..., Sighting | None]) -> Sighting | None:
    """Wait until a robot lets us in. Returns where it is instead, if it is elsewhere."""
    name, looked = _announced(link.robot), -_LOOK_AROUND
    while True:
        try:
            link.session  # noqa: B018  it connects
        except UntrustedHostKey:
            # Another computer may have its address now. If not, waiting does not make the key right.
            if there := search(link.robot, name=name):
                return there
            raise
        except _NOT_YET as problem:
            late = time.monotonic() >= deadline
            if not link.closed.is_set() and (late or time.monotonic() - looked >= _LOOK_AROUND):
                looked = time.monotonic()
                if there := search(link.robot, name=name):
                    return there
            _wait_on(link, problem, deadline=deadline, late=_late)
        else:
            return None


def _wait_on(
    link: Link, problem: FleetError, *, deadline: float, late: Callable[[Robot, FleetError], FleetError]
) -> None:
    """Wait a moment for the next attempt. Re-raise the problem after Ctrl-C, and when the time is over."""
    if link.closed.is_set():
        raise problem
    if time.monotonic() >= deadline:
        raise late(link.robot, problem)
    link.closed.wait(min(_PAUSE, max(0.0, deadline - time.monotonic())))


def _announced(robot: Robot) -> str:
    try:
        return f"{first_boot.hostname(robot)}.local"
    except UsageError:
        return ""


def _moved(robot: Robot, there: Sighting) -> Outcome:
    at = there.candidate.address
    cure = f"write `address: {at}` for {robot.name} into the inventory, then `fab trust --hosts {robot.name}` shows the same key"
    if robot.address.endswith(".local") and not neighbours.resolved(robot.address):
        cure = f"this computer resolves no .local names: install libnss-mdns, or {cure}"
    return Outcome(
        robot=robot.name,
        status="failed",
        reason=f"it is up at {at}, by its host key, and not at {robot.address}",
        cure=cure,
    )


def _not_over(robot: Robot, problem: FleetError) -> FleetError:
    cure = (
        f"`fab await --hosts {robot.name} --timeout 1200` waits longer; "
        f"`fab run --hosts {robot.name} -- cloud-init status --long` shows how far it is"
    )
    return NotReady(f"it is up, and its first boot is not over: {problem.what}", cure=cure)


def _late(robot: Robot, problem: FleetError) -> FleetError:
    what = f"it has not come up: {problem.what}"
    if isinstance(problem, LoginRefused):
        # Power and network are right. Without cloud-init's user there is no login.
        return LoginRefused(what, cure=problem.cure)
    cure = (
        "see whether it has power, and whether its Wi-Fi is right; `fab find --scan` looks for it at every address; "
        f"`fab await --hosts {robot.name} --timeout 1200` waits longer"
    )
    return type(problem)(what, cure=cure)
