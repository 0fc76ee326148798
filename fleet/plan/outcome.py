"""What is the result for one robot?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from fleet.errors import Unreachable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.errors import FleetError

Status = Literal["done", "unchanged", "failed", "unreachable", "skipped"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The result for one robot. ``step``, ``reason`` and ``cure`` are empty unless it failed.

    ``transfer`` is how the images were sent, with the reason if an earlier attempt had failed. ``unusable``: the bytes
    arrived, and the robot's Docker cannot use them; another kind of transfer may help.
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

    @property
    def good(self) -> bool:
        """Whether the robot is in the state that was asked for."""
        return self.status in ("done", "unchanged")


def failure(robot: str, problem: FleetError) -> Outcome:
    """The outcome of a robot whose work ended in an error."""
    status: Status = "unreachable" if isinstance(problem, Unreachable) else "failed"
    return Outcome(robot=robot, status=status, reason=problem.what, cure=problem.cure)


def together(outcomes: Sequence[tuple[str, Outcome]]) -> Outcome:
    """What became of a robot with several stacks: each is told with its name; the worst decides."""
    if len(outcomes) == 1:
        return outcomes[0][1]
    worst = next((one for _, one in outcomes if not one.good), None)
    summary = "; ".join(f"{stack}: {one.summary}" for stack, one in outcomes if one.good)
    transfer = "; ".join(f"{stack}: {one.transfer}" for stack, one in outcomes if one.transfer)
    whole = {"summary": summary, "sent": sum(one.sent for _, one in outcomes), "transfer": transfer}
    if worst:
        name = next(stack for stack, one in outcomes if one is worst)
        return replace(worst, step=f"{name}: {worst.step}" if worst.step else name, **whole)  # type: ignore[arg-type]
    done = any(one.status == "done" for _, one in outcomes)
    return replace(outcomes[0][1], status="done" if done else "unchanged", **whole)  # type: ignore[arg-type]


def exit_code(outcomes: tuple[Outcome, ...]) -> int:
    """0 if every outcome is good, else 1."""
    return 0 if all(outcome.good for outcome in outcomes) else 1
