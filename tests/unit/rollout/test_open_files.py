from __future__ import annotations

import errno
import resource

import pytest

from fleet.errors import DesktopError
from fleet.rollout import open_files


class Limits:
    """The limits of a computer, in place of this one's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *limits: int) -> None:
        self.now = limits
        monkeypatch.setattr(resource, "getrlimit", lambda _: self.now)
        monkeypatch.setattr(resource, "setrlimit", lambda _, limits: setattr(self, "now", limits))


@pytest.mark.parametrize(
    ("before", "robots", "after"),
    [
        ((1024, 4096), 32, (1024, 4096)),
        ((64, 4096), 32, (344, 4096)),
        ((256, resource.RLIM_INFINITY), 200, (680, resource.RLIM_INFINITY)),
        ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), 200, (resource.RLIM_INFINITY,) * 2),
        ((64, 64), 3, (64, 64)),
    ],
)
def test_the_limit_is_raised_as_far_as_it_must_be(
    monkeypatch: pytest.MonkeyPatch, before: tuple[int, int], robots: int, after: tuple[int, int]
) -> None:
    """A soft limit is a default that a program may change; `ulimit -n 64` is enough for three robots."""
    limits = Limits(monkeypatch, *before)
    open_files.allow(robots, connecting=32)
    assert limits.now == after


def test_a_hard_limit_that_is_too_low_is_told_before_anything_is_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not as a traceback out of the middle of a ship."""
    Limits(monkeypatch, 64, 64)
    with pytest.raises(DesktopError, match="allows 64 open files, and 32 connections at once need 344"):
        open_files.allow(32, connecting=32)


@pytest.mark.parametrize("code", [errno.EMFILE, errno.ENFILE])
def test_one_too_many_is_told(code: int) -> None:
    """Wherever it happens."""
    refusal = open_files.refusal(OSError(code, "Too many open files"))
    assert refusal is not None
    assert "open files, which are too few" in refusal.what
    assert "ulimit -n" in refusal.cure


def test_another_error_is_another() -> None:
    """It stays what it is."""
    assert open_files.refusal(OSError(errno.ENOSPC, "No space left on device")) is None
