from __future__ import annotations

from math import inf
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.ros.quality import Quality, mismatches

QUALITIES = st.builds(
    Quality,
    reliable=st.booleans(),
    durability=st.integers(0, 5),
    deadline=st.sampled_from([0.1, 1.0, inf]),
    liveliness=st.integers(0, 5),
    lease=st.sampled_from([0.1, 1.0, inf]),
)


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [
        ({"reliable": True}, "it wants reliable messages, and the publisher is best effort"),
        (
            {"durability": 1},
            "it wants the messages of before (transient local), and the publisher is volatile",
        ),
        ({"deadline": 0.5}, "its deadline is 0.5 s, and that of the publisher is not limited"),
        (
            {"liveliness": 2, "lease": 1.0},
            (
                "its liveliness is manual by topic with a lease that is 1 s, and that of the publisher is automatic with "
                "a lease that is not limited"
            ),
        ),
    ],
)
def test_less_than_is_wanted(wanted: dict[str, Any], reason: str) -> None:
    """Each quality has a clause of its own; the other way round, more than is wanted is well."""
    plain, strict = Quality(), Quality(**wanted)
    assert mismatches(offered=plain, wanted=strict) == (reason,)
    assert mismatches(offered=strict, wanted=plain) == ()


@given(QUALITIES, QUALITIES, QUALITIES)
def test_order(one: Quality, two: Quality, three: Quality) -> None:
    """What is offered fits itself; and who fits one that fits another fits that one, too."""
    assert mismatches(offered=one, wanted=one) == ()
    if not mismatches(offered=one, wanted=two) and not mismatches(offered=two, wanted=three):
        assert mismatches(offered=one, wanted=three) == ()


def test_in_words() -> None:
    """The two qualities that people choose; numbers that DDS does not have stay numbers."""
    assert str(Quality()) == "best effort, volatile"
    assert str(Quality(reliable=True, durability=1)) == "reliable, transient local"
    assert str(Quality(durability=9)) == "best effort, 9"
