from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from fleet.errors import LinkLost
from fleet.rollout import reconnect
from fleet.rollout.link import Link
from fleet.rollout.reconnect import RetryTimer
from tests.support.homes import Home, Told, start

if TYPE_CHECKING:
    from tests.support.sshd import Sshds

LOST = LinkLost("the connection was lost")


@pytest.fixture
def home(sshds: Sshds) -> Home:
    return start(sshds, "pi1")


def test_a_retry_uses_a_new_connection_and_is_reported(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    """The person sees for how long it goes on."""
    monkeypatch.setattr(reconnect, "_PAUSES", (0.1,))
    link, told = Link(home.robot), Told()
    before = link.session
    RetryTimer(link, seconds=180, progress=told).wait(LOST)
    assert link.session is not before
    link.close()
    assert told.said == [("pi1", "the connection was lost; trying again for 3 min")]


def test_the_error_is_raised_when_the_time_is_used_up(home: Home) -> None:
    """A restart of the timer allows the whole time again."""
    link, told = Link(home.robot), Told()
    timer = RetryTimer(link, seconds=0.05, progress=told)
    time.sleep(0.1)
    with pytest.raises(LinkLost):
        timer.wait(LOST)
    timer.restart()
    timer.wait(LOST)
    assert len(told.said) == 1


def test_ctrl_c_ends_the_retries(home: Home) -> None:
    """A closed link never connects again."""
    link, told = Link(home.robot), Told()
    link.close()
    with pytest.raises(LinkLost):
        RetryTimer(link, seconds=60, progress=told).wait(LOST)
    assert told.said == []
