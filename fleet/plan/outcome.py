"""What is the result for one robot?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from fleet.errors import Refused, Unreachable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.errors import FleetError

Status = Literal["done", "unchanged", "planned", "failed", "unreachable", "skipped"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The result for one robot. ``step``, ``reason`` and ``cure`` are empty unless it failed.

    ``planned``: with ``--dry``, there is something to do, and it was not done.

    ``transfer`` is how the images were sent, with the reason if an earlier attempt had failed. ``unusable``: the bytes
    arrived, and the robot's Docker cannot use them; another kind of transfer may help. ``refused``: what was asked does
    not fit the robot, and nothing was changed.
    """

    robot: str
    status: Status
    summary: str = ""
    step: str = ""
    reason: str = ""
    cure: str = ""
    seconds: float = 0.0
    sent: int = 0
    transfer: str = ""
    unusable: bool = False
    refused: bool = False

    @property
    def good(self) -> bool:
        """Whether the robot is in the state that was asked for, or nothing was asked for but a plan."""
        return self.status in ("done", "unchanged", "planned")


def failure(robot: str, problem: FleetError) -> Outcome:
    """The outcome of a robot whose work ended in an error."""
    status: Status = "unreachable" if isinstance(problem, Unreachable) else "failed"
    refused = problem.exit_code == Refused.exit_code
    return Outcome(robot=robot, status=status, reason=problem.what, cure=problem.cure, refused=refused)


def together(robot: str, outcomes: Sequence[tuple[str, Outcome]]) -> Outcome:
    """What became of a robot with several stacks, each with its name: the first that failed decides."""
    if not outcomes:
        return Outcome(robot=robot, status="unchanged", summary="has no stack")
    if len(outcomes) == 1:
        return outcomes[0][1]
    failed = next((pair for pair in outcomes if not pair[1].good), None)
    done = any(one.status == "done" for _, one in outcomes)
    whole = replace(
        failed[1] if failed else outcomes[0][1],
        summary="; ".join(f"{stack}: {one.summary}" for stack, one in outcomes if one.good),
        sent=sum(one.sent for _, one in outcomes),
        transfer="; ".join(f"{stack}: {one.transfer}" for stack, one in outcomes if one.transfer),
    )
    if failed:
        return replace(whole, step=": ".join(filter(None, (failed[0], whole.step))))
    return replace(whole, status="done" if done else "unchanged")


def exit_code(outcomes: tuple[Outcome, ...]) -> int:
    """0 if every outcome is good; 2 if no robot was changed, and what was asked is why; else 1."""
    bad = [outcome for outcome in outcomes if not outcome.good]
    if not bad:
        return 0
    changed = any(outcome.status == "done" for outcome in outcomes)
    return 2 if all(outcome.refused for outcome in bad) and not changed else 1
