from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.transfer.link_rates import ENOUGH_TO_MEASURE, LinkRates, lowest

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "5",
        "null",
        '{"pi": "fast"}',
        '{"pi": null}',
        '{"pi": [1]}',
        "\xff",
        f'{{"pi": {"9" * 400}}}',
    ],
)
def test_an_unreadable_file_counts_as_no_file(tmp_path: Path, text: str) -> None:
    """The next transfer replaces it."""
    path = tmp_path / "rates.json"
    path.write_text(text, encoding="latin-1")
    rates = LinkRates(path)
    assert rates.of("pi") is None
    rates.note("pi", 2 * ENOUGH_TO_MEASURE, 2.0)
    assert rates.of("pi") == ENOUGH_TO_MEASURE


@pytest.mark.parametrize(
    ("count", "seconds", "rate"),
    [
        (ENOUGH_TO_MEASURE, 1.0, 500_000),
        (ENOUGH_TO_MEASURE - 1, 1.0, None),
        (ENOUGH_TO_MEASURE, 0.0, None),
        (10**9, 3.0, 333_333_333),
    ],
)
def test_a_transfer_that_measures_nothing_is_not_recorded(
    tmp_path: Path, count: int, seconds: float, rate: float | None
) -> None:
    """A few bytes fit into the buffers on the way."""
    rates = LinkRates(tmp_path / "new/rates.json")
    rates.note("pi", count, seconds)
    assert rates.of("pi") == rate


def test_rates_of_other_robots_stay(tmp_path: Path) -> None:
    """One line for each address, also from another run."""
    path = tmp_path / "rates.json"
    LinkRates(path).note("pi1", ENOUGH_TO_MEASURE, 1.0)
    LinkRates(path).note("pi2", ENOUGH_TO_MEASURE, 2.0)
    LinkRates(path).note("pi1", ENOUGH_TO_MEASURE, 4.0)
    assert json.loads(path.read_text()) == {"pi1": 125_000, "pi2": 250_000}


def test_rates_that_cannot_be_written_are_ignored(tmp_path: Path) -> None:
    """They are only used for a forecast."""
    (tmp_path / "file").write_text("in the way")
    rates = LinkRates(tmp_path / "file/rates.json")
    rates.note("pi", ENOUGH_TO_MEASURE, 1.0)
    assert rates.of("pi") is None


@pytest.mark.parametrize(
    ("rates", "rate"), [((), None), ((None, None), None), ((None, 5.0), 5.0), ((7.0, 0.0, 5.0), 5.0)]
)
def test_the_lowest_rate_of_those_that_are_known(rates: tuple[float | None, ...], rate: float | None) -> None:
    """Neither None nor 0 is a rate that was measured."""
    assert lowest(*rates) == rate
