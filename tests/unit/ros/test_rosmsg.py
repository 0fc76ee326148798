from __future__ import annotations

import contextlib
import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fleet.ros.rosmsg import DEEPEST, MOST_VALUES, Time, Undecodable, decode, parse, text

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    from fleet.ros.rosmsg import Field

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
        ("float64[999999999] data", b"", "ends 7999999992 bytes too early"),
        (f"uint8[{'9' * 5000}] data", b"", "has the line"),
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


NUMBERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
DEFINITIONS = {
    "numbers": "\n".join(f"{kind} a_{kind}" for kind in NUMBERS),
    "arrays": "\n".join(f"{kind}[] a_{kind}\n{kind}[3] three_{kind}" for kind in NUMBERS),
    "text": "string one\nstring[] many\nstring[2] two\nbool yes\nbool[] flags",
    "times": "time stamp\nduration took\ntime[] stamps\nduration[2] both",
    "constants": "uint8 LAST=3\nstring UNIT=m # metres\nfloat64 value # a comment",
    "nested": f"Header header\nPoint[] points\nPoint[2] corners\nother/Tag tag\n{HEADER}"
    f"{'=' * 80}\nMSG: pkg/Point\nfloat64 x\nfloat32 y\n"
    f"{'=' * 80}\nMSG: other/Tag\nstring name\nuint8[] raw\n",
}


def rosbags_name(name: str) -> str:
    return name.replace("/", "/msg/")


def drawn(data: st.DataObject, kind: str, store: Typestore, types: dict[str, tuple[Field, ...]]) -> Any:  # noqa: ANN401
    """A value of a type, as rosbags takes it."""
    draw = data.draw
    if kind == "string":
        return draw(st.text(st.characters(codec="utf-8"), max_size=8))
    if kind == "bool":
        return draw(st.booleans())
    if kind in NUMBERS:
        size = np.dtype(kind).itemsize * 8
        if kind.startswith("float"):
            return draw(st.floats(width=size, allow_nan=False))  # type: ignore[arg-type]
        low, high = (0, 2**size - 1) if kind.startswith("u") else (-(2 ** (size - 1)), 2 ** (size - 1) - 1)
        return draw(st.integers(low, high))
    if kind in ("time", "duration"):
        # rosbags reads ROS 2's types: signed seconds, unsigned nanoseconds. Both agree where ROS 1's values lie.
        seconds = st.integers(0 if kind == "time" else -(2**31), 2**31 - 1)
        made = store.types[f"builtin_interfaces/msg/{kind.title()}"]
        return made(sec=draw(seconds), nanosec=draw(st.integers(0, 999_999_999)))
    values: dict[str, Any] = {field.name: drawn_field(data, field, store, types) for field in types[kind]}
    return store.types[rosbags_name(kind)](**values)


def drawn_field(
    data: st.DataObject, field: Field, store: Typestore, types: dict[str, tuple[Field, ...]]
) -> object:
    if not field.array:
        return drawn(data, field.type, store, types)
    count = data.draw(st.integers(0, 4)) if field.length is None else field.length
    values = [drawn(data, field.type, store, types) for _ in range(count)]
    return np.array(values, dtype=field.type) if field.type in (*NUMBERS, "bool") else values


def plain(value: Any, fields: dict[str, tuple[Field, ...]], kind: str) -> Any:  # noqa: ANN401
    """What rosbags read, in our parser's types."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if kind == "uint8" else value.tolist()
    if isinstance(value, list):
        return [plain(item, fields, kind) for item in value]
    if kind in ("time", "duration"):
        return Time(value.sec, value.nanosec)
    if kind in fields:
        return {one.name: plain(getattr(value, one.name), fields, one.type) for one in fields[kind]}
    return value


@pytest.mark.parametrize("definition", DEFINITIONS.values(), ids=DEFINITIONS)
@settings(max_examples=25)
@given(data=st.data())
def test_messages_are_read_as_rosbags_reads_them(definition: str, data: st.DataObject) -> None:
    """An independent implementation writes the bytes, and both read the same values from them."""
    name = "pkg/Type"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, rosbags_name(name)))
    types = parse(name, definition)
    written = bytes(store.serialize_ros1(drawn(data, name, store, types), rosbags_name(name)))
    read = store.deserialize_ros1(written, rosbags_name(name))
    assert decode(written, name, types) == plain(read, types, name)
