from __future__ import annotations

import pytest

from fleet.errors import NotAsPlanned, Refused, Unreachable, UsageError
from fleet.plan.outcome import Outcome, Status, exit_code, failure


def test_an_error_as_an_outcome() -> None:
    """Only what was never reached is unreachable."""
    assert failure("pi1", Unreachable("away", cure="look")) == Outcome(
        robot="pi1", status="unreachable", reason="away", cure="look"
    )
    assert failure("pi1", NotAsPlanned("odd")).status == "failed"
    assert failure("pi1", Refused("taken")).refused
    assert failure("pi1", UsageError("no such folder", cure="look")).refused


@pytest.mark.parametrize(
    ("statuses", "code"),
    [
        ((), 0),
        (("done", "unchanged"), 0),
        (("done", "failed"), 1),
        (("unreachable", "done"), 1),
        (("skipped",), 1),
    ],
)
def test_the_exit_code_is_0_only_if_every_robot_is_as_asked(statuses: tuple[Status, ...], code: int) -> None:
    """One robot that failed, was not reached or was left out is enough for a 1."""
    assert exit_code(tuple(Outcome(robot="pi1", status=status) for status in statuses)) == code


def test_a_refusal_has_a_code_of_its_own() -> None:
    """As long as it is the only problem, and nothing was changed anywhere."""
    refused = failure("pi1", Refused("the port is taken"))
    runs, shipped = Outcome(robot="pi2", status="unchanged"), Outcome(robot="pi2", status="done")
    broken = Outcome(robot="pi2", status="failed")
    assert [exit_code((refused, *more)) for more in ((), (runs,), (shipped,), (broken,))] == [2, 2, 1, 1]
