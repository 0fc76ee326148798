from __future__ import annotations

import struct
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.ros import rtps_discovery
from fleet.ros.quality import Quality
from tests.support.ros2_peer import END, parameter, string

GUID = bytes(range(16))
NAMED = parameter(0x5A, GUID) + parameter(0x05, string("rt/a")) + parameter(0x07, string("T"))


def payload(*said: bytes) -> bytes:
    return b"\0\3\0\0" + NAMED + b"".join(said) + END


def test_all_qualities() -> None:
    """As Fast DDS writes them; a duration without end is one."""
    found = rtps_discovery.endpoint(
        payload(
            parameter(0x1A, struct.pack("<IiI", 2, 0, 0)),
            parameter(0x1D, struct.pack("<I", 1)),
            parameter(0x23, struct.pack("<iI", 1, 1 << 31)),
            parameter(0x1B, struct.pack("<IiI", 2, 0x7FFFFFFF, 0xFFFFFFFF)),
        ),
        publishes=True,
    )
    assert found
    assert found.quality == Quality(reliable=True, durability=1, deadline=1.5, liveliness=2, lease=inf)
    assert (found.guid, found.topic, found.type, found.keeps) == (GUID, "rt/a", "T", True)


@pytest.mark.parametrize("publishes", [True, False])
def test_defaults(publishes: bool) -> None:
    """Cyclone DDS leaves out what is the default, which differs in one quality."""
    found = rtps_discovery.endpoint(payload(), publishes=publishes)
    assert found
    assert found.quality == Quality(reliable=publishes)


@given(st.lists(st.tuples(st.sampled_from([0x1A, 0x1B, 0x1D, 0x23]), st.binary(max_size=16))))
def test_short_and_odd_qualities(said: list[tuple[int, bytes]]) -> None:
    """Nothing raises."""
    rtps_discovery.endpoint(payload(*(parameter(name, value) for name, value in said)), publishes=True)


def test_names_of_types() -> None:
    """As ROS writes them, if they are ROS's."""
    assert rtps_discovery.ros_type("std_msgs::msg::dds_::String_") == "std_msgs/msg/String"
    assert rtps_discovery.ros_type("Odd") == "Odd"


@pytest.mark.parametrize(("length", "found"), [(256, True), (257, False), (60_000, False)])
def test_names_that_are_too_long(length: int, *, found: bool) -> None:
    """Each is sent again, in a subscription: a part has 64 kB."""
    for name in (0x05, 0x07):
        said = (
            parameter(0x5A, GUID)
            + parameter(0x0C - name, string("T"))
            + parameter(name, string("x" * length))
        )
        assert bool(rtps_discovery.endpoint(b"\0\3\0\0" + said + END, publishes=True)) is found


def test_a_participant_with_many_addresses() -> None:
    """Each of them would get our datagrams."""
    place = struct.pack("<iI", 1, 7410) + bytes(12) + bytes((10, 0, 0, 1))
    said = rtps_discovery.participant(b"\0\3\0\0" + parameter(0x32, place) * 2000 + END, prefix=bytes(12))
    assert len(said.meta) == rtps_discovery.MOST_PLACES
