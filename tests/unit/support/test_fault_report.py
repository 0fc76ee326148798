from __future__ import annotations

from tests.support.fault_report import Fault, page, table

CUT = Fault(fault="power cut", times=200, end="one release")


def test_a_table_has_a_row_for_each_fault() -> None:
    """Columns are as wide as their widest cell."""
    assert table([CUT]).splitlines() == [
        "| fault     | times | how each of them ended |",
        "| --------- | ----- | ---------------------- |",
        "| power cut | 200   | one release            |",
    ]


def test_the_page_says_whether_a_test_failed() -> None:
    """A failed one has no row, so its absence must be told."""
    assert "No test of this run failed." in page([CUT], failed=0)
    assert "2 tests of this run FAILED" in page([CUT], failed=2)
    assert table([CUT]) in page([CUT], failed=0)
