"""Which host keys do the robots offer, and which of them are recorded?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.plan.outcome import Outcome
from fleet.rollout.pool import each
from fleet.ssh import connect, known_hosts, openssh_config

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from fleet.config.inventory import Robot
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress
    from fleet.ssh.known_hosts import HostKey, Verdict


ASK = "ask for the host key"
"""The title of the only step."""


@dataclass(frozen=True, kw_only=True)
class Offer:
    """The host key that a robot offers, its name in ``known_hosts`` files, and whether it is known there."""

    robot: Robot
    name: str
    key: HostKey
    verdict: Verdict

    def text(self) -> str:
        """One line a person can compare with ``ssh-keygen -lf`` on the robot."""
        return f"{self.robot.name}  {self.name}  {self.key.kind}  {self.key.fingerprint}  {self.verdict}"


def offered_keys(
    robots: Sequence[Robot], *, progress: Progress
) -> tuple[tuple[Offer, ...], tuple[Outcome, ...]]:
    """Ask every robot for its host key, without logging in. Returns the offers, and the outcomes of unreachable robots."""
    offers: dict[str, Offer] = {}

    def ask(link: Link) -> Outcome:
        robot = link.robot
        progress.step_started(robot.name, ASK, None)
        name, key = connect.offered_key(robot)
        known = known_hosts.read((robot.known_hosts, *openssh_config.resolve(robot).known_hosts))
        offers[robot.name] = Offer(robot=robot, name=name, key=key, verdict=known.verdict(name, key))
        return Outcome(robot=robot.name, status="done")

    progress.announce([robot.name for robot in robots], ASK)
    outcomes = each(robots, ask, progress=progress)
    there = tuple(offers[robot.name] for robot in robots if robot.name in offers)
    return there, tuple(outcome for outcome in outcomes if not outcome.good)


def to_record(offers: Iterable[Offer], *, changed: bool) -> tuple[Offer, ...]:
    """Select the offers to record: unknown keys, changed ones only with ``changed``, revoked ones never."""
    wanted = {"unknown", "changed"} if changed else {"unknown"}
    return tuple(offer for offer in offers if offer.verdict in wanted)


def outcome(offer: Offer, *, recorded: bool, dry: bool) -> Outcome:
    """Return the outcome of one offer, or with ``dry`` what would be done."""
    summary = f"{offer.key.kind} {offer.key.fingerprint}"
    if recorded and dry:
        return Outcome(robot=offer.robot.name, status="planned", summary=f"would record {summary}")
    if recorded:
        return Outcome(robot=offer.robot.name, status="done", summary=f"recorded {summary}")
    if offer.verdict == "known":
        return Outcome(robot=offer.robot.name, status="unchanged", summary=f"known {summary}")
    cures = {
        "unknown": "`fab trust` asks before it records the key; `fab trust --yes` does not ask",
        "changed": "if the robot was reinstalled: `fab trust --changed`",
    }
    reason = f"its host key is {offer.verdict} and was not recorded: {summary}"
    return Outcome(robot=offer.robot.name, status="failed", reason=reason, cure=cures.get(offer.verdict, ""))


def record(offers: Iterable[Offer]) -> None:
    """Write the keys into the known_hosts file of each robot's inventory."""
    for offer in offers:
        known_hosts.record(offer.robot.known_hosts, name=offer.name, key=offer.key)
