from __future__ import annotations

import json
from math import inf, nan
from typing import TYPE_CHECKING

import pytest

from fleet.ros.message import Message, plain, stamp
from fleet.ros.rosmsg import Time

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.ros.rosmsg import Value


def test_text_is_read_when_it_is_wanted() -> None:
    """Who only counts messages does not need their type."""
    read: list[str] = []

    def values() -> dict[str, Value]:
        read.append("now")
        return {"data": "noon"}

    message = Message(at=1.0, monotonic=1.0, size=8, read=values)
    assert not read
    assert message.text() == 'data: "noon"'


def test_values_as_json() -> None:
    """Whatever a message holds can be written."""
    value = plain({"a": b"\0\1", "b": [nan, 1.5], "c": {"d": Time(3, 4)}, "e": -inf, "f": True, "g": "x"})
    assert json.loads(json.dumps(value, allow_nan=False)) == {
        "a": "AAE=",
        "b": [None, 1.5],
        "c": {"d": {"secs": 3, "nsecs": 4}},
        "e": None,
        "f": True,
        "g": "x",
    }


@pytest.mark.parametrize(
    ("values", "seconds"),
    [
        ({"header": {"stamp": {"sec": 3, "nanosec": 500_000_000}}, "ranges": []}, 3.5),
        ({"header": {"seq": 1, "stamp": Time(3, 500_000_000)}}, 3.5),
        ({"stamp": {"sec": 3, "nanosec": 0}, "frame_id": ""}, 3.0),
        ({"sec": 3, "nanosec": 0}, 3.0),
        ({"data": Time(3, 0)}, 3.0),
        ({"data": "noon"}, None),
        ({"header": 7}, None),
        ({"header": {"stamp": 7}}, None),
        ({"stamp": {"sec": "x", "nanosec": 0}}, None),
        ({}, None),
    ],
)
def test_stamp(values: Mapping[str, Value], seconds: float | None) -> None:
    """Of a header, of a message that is a header, and of one that is a time, in both versions of ROS."""
    assert stamp(values) == seconds
