from __future__ import annotations

import threading
from typing import Self

import pytest

from fleet.cli.beside import beside
from fleet.errors import DesktopError


class Door:
    """Something that wants to be closed."""

    def __init__(self) -> None:
        self.closed = threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.closed.set()


def test_work_goes_on_beside() -> None:
    """It has begun before anybody asks for the result."""
    begun = threading.Event()

    def work() -> int:
        begun.set()
        return 3

    with beside(work) as result:
        assert begun.wait(5)
        assert (result(), result()) == (3, 3)


def test_an_error_is_raised_where_the_result_is_needed() -> None:
    """And only there: `--dry` needs no Docker."""

    def work() -> int:
        raise DesktopError("Docker does not answer")

    with beside(work) as result, pytest.raises(DesktopError, match="does not answer"):
        result()
    with beside(work):
        pass


@pytest.mark.parametrize("asked", [True, False])
def test_what_nobody_asked_for_is_closed(asked: bool) -> None:
    """Who asked for it closes it."""
    door = Door()
    with beside(lambda: door) as result:
        if asked:
            result()
    assert door.closed.is_set() != asked
