from __future__ import annotations

import inspect

import pytest

from fleet.cli.console import Bars, Lines
from fleet.rollout.progress import NoProgress, Progress
from tests.support.homes import Told

METHODS = [name for name in vars(Progress) if not name.startswith("_")]


@pytest.mark.parametrize("receiver", [NoProgress, Lines, Bars, Told], ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("method", METHODS)
def test_every_receiver_takes_the_same_reports(receiver: type[Progress], method: str) -> None:
    """With the same parameters, by position and by name."""
    expected = inspect.signature(getattr(Progress, method))
    assert inspect.signature(getattr(receiver, method)) == expected


def test_no_progress_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever it is told."""
    progress = NoProgress()
    progress.announce(["pi1", "pi2"], "look")
    progress.step_started("pi1", "load", 5)
    progress.bytes_sent("pi1", 5)
    progress.note("pi1", "slow")
    assert capsys.readouterr() == ("", "")
