from __future__ import annotations

import pytest

from fleet.units import human_bytes, human_seconds


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (0, "0 B"),
        (7, "7 B"),
        (999, "999 B"),
        (1000, "1.0 kB"),
        (9_940, "9.9 kB"),
        (9_960, "10 kB"),
        (999_400, "999 kB"),
        (999_600, "1.0 MB"),
        (241_700_000, "242 MB"),
        (999_999_999, "1.0 GB"),
        (32_000_000_000, "32.0 GB"),
        (2_000_000_000_000, "2000.0 GB"),
    ],
)
def test_bytes_as_people_say_them(count: int, said: str) -> None:
    """Decimal units, one digit after the point below ten, and never ``1000 kB``."""
    assert human_bytes(count) == said


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0, "0 s"),
        (0.4, "0 s"),
        (119, "119 s"),
        (120, "2 min"),
        (7199, "120 min"),
        (7200, "2 h"),
        (172_799, "48 h"),
        (172_800, "2 d"),
    ],
)
def test_spans_as_people_say_them(seconds: float, said: str) -> None:
    """A unit is used from two of it on: nobody says ``1 min`` of 90 seconds."""
    assert human_seconds(seconds) == said
