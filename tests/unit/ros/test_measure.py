from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.ros.measure import Clocks, Meter, Report, clocks


def reports(times: list[float], *, size: int = 100, delay: float | None = None) -> list[Report]:
    meter = Meter()
    return [found for at in times if (found := meter.add(at=at, size=size, delay=delay))]


def test_ten_in_a_second() -> None:
    """A report a second."""
    found = reports([number / 10 for number in range(35)])
    assert len(found) == 3
    assert found[-1].rate == pytest.approx(10)
    assert found[-1].bytes == pytest.approx(1000)
    assert str(found[-1]) == "10 messages/s, 100 to 100 ms apart, 1.0 kB/s"


def test_a_slow_topic() -> None:
    """A message in four seconds: the report is about more than the last second."""
    found = reports([0, 4, 8, 12])
    assert [round(one.rate, 3) for one in found] == [0.25, 0.25, 0.25]


def test_what_is_long_ago_does_not_count() -> None:
    """A topic that became slower."""
    found = reports([*(number / 10 for number in range(100)), *range(11, 30)])
    assert found[-1].rate == pytest.approx(1)
    assert found[-1].longest == pytest.approx(1)


def test_delays() -> None:
    """Mean, least and most, in milliseconds."""
    meter = Meter()
    meter.add(at=0, size=1, delay=0.004)
    found = meter.add(at=1, size=1, delay=0.02)
    assert str(found).endswith("; delay 12 ms (4.0 to 20 ms)")


@given(st.lists(st.floats(-1e12, 1e12), max_size=30))
def test_any_clock(times: list[float]) -> None:
    """A clock may jump: nothing raises, and nothing is divided by zero."""
    for report in reports(times, delay=1.0):
        assert str(report)


def test_two_clocks() -> None:
    """The shortest question counts; its answer came in the middle, give or take half of its time."""
    assert clocks([(100.0, 112.0, 104.0), (200.0, 210.5, 201.0)]) == Clocks(ahead=10.0, error=0.5)
    assert str(Clocks(ahead=-0.012, error=0.003)) == "its clock is 12 ms behind this computer's (± 3.0 ms)"
    assert str(Clocks(ahead=90, error=0.02)) == "its clock is 90000 ms ahead of this computer's (± 20 ms)"


def test_a_time_before_the_last_one() -> None:
    """It counts as the last one: no gap is negative, and reports go on."""
    found = reports([0, 0.5, 0.4, 1.0, 2.0])
    assert [(one.rate, one.shortest, one.longest) for one in found] == [(3.0, 0.0, 0.5), (2.0, 0.0, 1.0)]
