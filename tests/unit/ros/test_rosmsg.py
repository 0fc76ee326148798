from __future__ import annotations

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.ros.rosmsg import DEEPEST, MOST_VALUES, Time, Undecodable, decode, parse, text

HEADER = """
================================================================================
MSG: std_msgs/Header
# Standard metadata
uint32 seq
time stamp
string frame_id
"""
SCAN = f"""Header header            # a comment
string UNIT=m # not a comment, part of a constant
uint8 LAST = 3
float32 angle
float32[] ranges
geometry_msgs/Point[2] corners
Tag[] tags
duration[1] took
bool valid
uint8[] raw
{HEADER}
================================================================================
MSG: geometry_msgs/Point
float64 x
================================================================================
MSG: pkg/Tag
string name
"""
SCAN_BYTES = b"".join(
    (
        struct.pack("<III", 7, 100, 5) + struct.pack("<I", 4) + b"base",
        struct.pack("<f", 0.5),
        struct.pack("<I2f", 2, 1.5, -2.0),
        struct.pack("<dd", 1.0, 2.0),
        struct.pack("<I", 1) + struct.pack("<I", 5) + "caf\N{LATIN SMALL LETTER E WITH ACUTE}".encode(),
        struct.pack("<ii", -1, 3),
        b"\x01",
        struct.pack("<I", 2) + b"\x00\xff",
    )
)


def test_every_kind_of_field() -> None:
    """Headers, constants, arrays, nested types, times, booleans and bytes come out as sent."""
    assert decode(SCAN_BYTES, "pkg/Scan", parse("pkg/Scan", SCAN)) == {
        "header": {"seq": 7, "stamp": Time(100, 5), "frame_id": "base"},
        "angle": 0.5,
        "ranges": [1.5, -2.0],
        "corners": [{"x": 1.0}, {"x": 2.0}],
        "tags": [{"name": "caf\N{LATIN SMALL LETTER E WITH ACUTE}"}],
        "took": [Time(-1, 3)],
        "valid": True,
        "raw": b"\x00\xff",
    }


def test_text_reads_like_rostopic_echo() -> None:
    """Nested fields are indented, strings quoted, arrays in brackets."""
    assert text(decode(SCAN_BYTES, "pkg/Scan", parse("pkg/Scan", SCAN))).splitlines() == [
        "header:",
        "  seq: 7",
        "  stamp:",
        "    secs: 100",
        "    nsecs: 5",
        '  frame_id: "base"',
        "angle: 0.5",
        "ranges: [1.5, -2.0]",
        "corners:",
        "  -",
        "    x: 1.0",
        "  -",
        "    x: 2.0",
        "tags:",
        "  -",
        '    name: "caf\N{LATIN SMALL LETTER E WITH ACUTE}"',
        "took:",
        "  -",
        "    secs: -1",
        "    nsecs: 3",
        "valid: True",
        "raw: [0, 255]",
    ]


def test_long_arrays_are_cut_short() -> None:
    """A camera image does not flood the terminal."""
    assert text({"data": bytes(1000)}) == f"data: [{', '.join(['0'] * 32)}, ... 968 more]"


def test_control_characters_do_not_reach_the_terminal() -> None:
    """A string cannot clear the screen or start a new line."""
    assert text({"data": "a\x1b[2J\x9b2J\nb\x7f"}) == r'data: "a\u001b[2J\u009b2J\nb\u007f"'


@given(st.text(st.characters(codec="utf-8")))
def test_any_string_survives(value: str) -> None:
    """Strings are UTF-8, of any length."""
    data = value.encode()
    message = struct.pack("<I", len(data)) + data
    assert decode(message, "std_msgs/String", parse("std_msgs/String", "string data")) == {"data": value}


@given(st.binary(max_size=200))
def test_any_bytes_are_decoded_or_refused(data: bytes) -> None:
    """Bytes that are no such message raise `Undecodable`, nothing else."""
    with contextlib.suppress(Undecodable):
        assert decode(data, "pkg/Scan", parse("pkg/Scan", SCAN))


@given(st.text(max_size=200))
def test_any_definition_is_parsed_or_refused(definition: str) -> None:
    """A text that is no definition raises `Undecodable`, nothing else."""
    with contextlib.suppress(Undecodable):
        assert "pkg/Scan" in parse("pkg/Scan", definition)


@pytest.mark.parametrize(
    ("definition", "data", "reason"),
    [
        ("string data", b"\x05\x00\x00\x00abc", "ends 2 bytes too early"),
        ("uint8 data", b"\x01\x02", "1 bytes more"),
        ("float64[] data", b"\xff\xff\xff\xff", "too early"),
        ("Missing data", b"", "does not define it"),
        ("string", b"", "has the line"),
    ],
)
def test_what_is_wrong_is_said(definition: str, data: bytes, reason: str) -> None:
    """Each refusal names its reason."""
    with pytest.raises(Undecodable, match=reason):
        decode(data, "pkg/Type", parse("pkg/Type", definition))


def test_type_that_contains_itself() -> None:
    """A definition that never ends is refused instead of followed."""
    with pytest.raises(Undecodable, match=f"{DEEPEST} messages deep"):
        decode(b"", "pkg/Type", parse("pkg/Type", "Type child"))


def test_message_that_is_all_empty_values() -> None:
    """Four bytes cannot ask for four thousand million values that need no bytes."""
    definition = "Empty[] data\n====\nMSG: pkg/Empty\n"
    with pytest.raises(Undecodable, match=f"more than {MOST_VALUES} values"):
        decode(b"\xff\xff\xff\xff", "pkg/Type", parse("pkg/Type", definition))
