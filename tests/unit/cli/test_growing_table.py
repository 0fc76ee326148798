from __future__ import annotations

import time

import pytest

from fleet.cli import growing_table
from fleet.cli.growing_table import GrowingTable

Row = tuple[tuple[str, str], ...]


class Rows:
    """Rows that come by and by, and what was shown of them, each time with whether it was the first."""

    def __init__(self) -> None:
        self.there: list[Row] = []
        self.shown: list[tuple[list[str], bool]] = []

    def add(self, *names: str) -> None:
        self.there += [((name, ""),) for name in names]

    def show(self, rows: object, first: bool) -> None:
        self.shown.append(([row[0][0] for row in rows], first))  # type: ignore[attr-defined]


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_table, "FIRST", 0.2)
    monkeypatch.setattr(growing_table, "NEXT", 0.05)


def wait_for(rows: Rows, count: int) -> None:
    end = time.monotonic() + 10
    while len(rows.shown) < count:
        assert time.monotonic() < end
        time.sleep(0.01)


def test_what_is_there_soon_is_one_table() -> None:
    """Its columns fit."""
    rows = Rows()
    with GrowingTable(lambda: rows.there, rows.show):
        rows.add("one")
        rows.add("two")
    assert rows.shown == [(["one", "two"], True)]


def test_later_rows_follow() -> None:
    """Each is shown once, and none waits for the last."""
    rows = Rows()
    with GrowingTable(lambda: list(rows.there), rows.show):
        rows.add("one")
        wait_for(rows, 1)
        rows.add("two", "three")
        wait_for(rows, 2)
        rows.add("four")
    assert rows.shown == [(["one"], True), (["two", "three"], False), (["four"], False)]


def test_a_table_without_rows_has_its_headings() -> None:
    """Once."""
    rows = Rows()
    with GrowingTable(lambda: rows.there, rows.show):
        time.sleep(0.4)
    assert rows.shown == [([], True)]


def test_a_reader_that_is_gone_is_noticed() -> None:
    """`fab status | head -1`."""

    def gone(_rows: object, _first: bool) -> None:
        raise BrokenPipeError

    rows = Rows()
    rows.add("one")
    with pytest.raises(BrokenPipeError), GrowingTable(lambda: rows.there, gone):
        time.sleep(0.4)


def test_after_an_error_nothing_is_shown() -> None:
    """It is what is told."""
    rows = Rows()
    rows.add("one")
    with pytest.raises(ZeroDivisionError), GrowingTable(lambda: rows.there, rows.show):
        raise ZeroDivisionError
    assert rows.shown == []
