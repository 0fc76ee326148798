from __future__ import annotations

import contextlib
import re
import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fleet.ros.cdr import decode, parse, type_name
from fleet.ros.rosmsg import DEEPEST, MOST_VALUES, Undecodable, text

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    from fleet.ros.cdr import Types
    from fleet.ros.rosmsg import Field

SCAN = """=== pkg/Scan
# what a scanner sees
std_msgs/Header header            # a comment
string UNIT=m # not a comment, part of a constant
uint8 LAST = 3
float32 angle 0.5
float64[] ranges
Point[2] corners
Tag[<=5] tags
string<=10[<=3] names
bool valid true
byte[] raw
uint8[2] two [1, 2]
=== std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
=== builtin_interfaces/Time
int32 sec
uint32 nanosec
=== pkg/Point
float64 x
=== pkg/Tag
string name
"""


def test_every_kind_of_field() -> None:
    """Bounds, defaults and constants are no values; each number lies at a multiple of its size."""
    data = b"\0\1\0\0"
    data += struct.pack("<iI", 7, 8) + struct.pack("<I", 5) + b"base\0"  # 17 bytes
    data += bytes(3) + struct.pack("<f", 0.5)  # 24
    data += struct.pack("<I", 1) + bytes(4) + struct.pack("<d", 1.5)  # 40
    data += struct.pack("<dd", 1.0, 2.0)
    data += struct.pack("<I", 1) + struct.pack("<I", 2) + b"t\0" + bytes(2)
    data += struct.pack("<I", 0)
    data += b"\1" + bytes(3) + struct.pack("<I", 2) + b"\0\xff" + b"\5\6"
    assert decode(data, "pkg/Scan", parse("pkg/Scan", SCAN)) == {
        "header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "base"},
        "angle": 0.5,
        "ranges": [1.5],
        "corners": [{"x": 1.0}, {"x": 2.0}],
        "tags": [{"name": "t"}],
        "names": [],
        "valid": True,
        "raw": b"\0\xff",
        "two": b"\5\6",
    }


def test_text_reads_like_ros2_topic_echo() -> None:
    """Times are messages in ROS 2."""
    types = parse("std_msgs/Header", SCAN)
    data = b"\0\1\0\0" + struct.pack("<iII", 7, 8, 1) + b"\0"
    assert text(decode(data, "std_msgs/Header", types)).splitlines() == [
        "stamp:",
        "  sec: 7",
        "  nanosec: 8",
        'frame_id: ""',
    ]


@pytest.mark.parametrize(
    ("head", "value"),
    [
        (b"\0\0\0\0", b"\0\0\0\1" + bytes(4) + b"\0\0\0\0\0\0\0\2"),
        (b"\0\1\0\0", b"\1\0\0\0" + bytes(4) + b"\2\0\0\0\0\0\0\0"),
        (b"\0\7\0\0", b"\1\0\0\0" + b"\2\0\0\0\0\0\0\0"),
        (b"\0\6\0\0", b"\0\0\0\1" + b"\0\0\0\0\0\0\0\2"),
    ],
)
def test_both_orders_and_versions_of_cdr(head: bytes, value: bytes) -> None:
    """In the second version, nothing is aligned to more than four bytes."""
    types = parse("pkg/Two", "=== pkg/Two\nint32 a\nint64 b\n")
    assert decode(head + value, "pkg/Two", types) == {"a": 1, "b": 2}


def test_a_type_without_fields() -> None:
    """Its message has one byte, and up to three more that fill the word."""
    types = parse("std_msgs/Empty", "=== std_msgs/Empty\n")
    assert decode(b"\0\1\0\0\0", "std_msgs/Empty", types) == {}
    assert decode(b"\0\1\0\3\0\0\0\0", "std_msgs/Empty", types) == {}


@pytest.mark.parametrize("dds", ["std_msgs::msg::dds_::String_", "a::msg::dds_::B2_"])
def test_type_names(dds: str) -> None:
    """DDS has ROS names in its own form."""
    assert type_name(dds) in ("std_msgs/String", "a/B2")


@pytest.mark.parametrize("dds", ["", "String", "a::srv::dds_::Get_Request_", "a::msg::dds_::B_; reboot"])
def test_other_type_names(dds: str) -> None:
    """Services, programs without ROS, and text that would be a command."""
    with pytest.raises(Undecodable, match="is not a message type of ROS"):
        type_name(dds)


@pytest.mark.parametrize(
    ("definition", "data", "reason"),
    [
        ("string data", b"\0\1\0\0\5\0\0\0abc", "ends 2 bytes too early"),
        ("uint8 data", b"\0\1\0\0" + bytes(5), "4 bytes more"),
        ("float64[] data", b"\0\1\0\0\xff\xff\xff\xff", "too early"),
        ("string[] data", b"\0\1\0\0\xff\xff\xff\xff", "ends before the 4294967295 elements of data"),
        ("uint8 data", b"\0\2\0\0\1", "not in plain CDR"),
        ("uint8 data", b"\0\1", "not in plain CDR"),
        ("Missing data", b"", "pkg/Type uses pkg/Missing, and no running container has a definition of it"),
        ("wstring data", b"", "is a wstring"),
        ("string", b"", "has the line"),
        ("uint8[999999999] data", b"", "array of 999999999"),
        (f"uint8[{'9' * 5000}] data", b"", "has the line"),
        (f"uint8[<={'9' * 5000}] data", b"", "has the line"),
    ],
)
def test_the_reason_is_given(definition: str, data: bytes, reason: str) -> None:
    """Each refusal names its reason."""
    with pytest.raises(Undecodable, match=reason):
        decode(data, "pkg/Type", parse("pkg/Type", f"=== pkg/Type\n{definition}\n"))


def test_no_definition() -> None:
    """A robot whose containers have another distribution, or none."""
    with pytest.raises(Undecodable, match="no running container of the robot has a definition of pkg/Type"):
        parse("pkg/Type", "")


def test_type_that_contains_itself() -> None:
    """A definition that never ends is refused instead of followed."""
    types = parse("pkg/Type", "=== pkg/Type\nType child\n")
    with pytest.raises(Undecodable, match=f"{DEEPEST} messages deep"):
        decode(b"\0\1\0\0", "pkg/Type", types)


def test_too_many_values() -> None:
    """A message of a few megabytes cannot become a million objects."""
    types = parse("pkg/Type", "=== pkg/Type\nEmpty[] data\n=== pkg/Empty\n")
    count = MOST_VALUES + 1
    with pytest.raises(Undecodable, match=f"more than {MOST_VALUES} values"):
        decode(b"\0\1\0\0" + struct.pack("<I", count) + bytes(count), "pkg/Type", types)


@given(st.sampled_from([b"\0\0", b"\0\1", b"\0\6", b"\0\7"]), st.binary(max_size=200))
def test_any_bytes_are_decoded_or_refused(encoding: bytes, data: bytes) -> None:
    """Bytes that are no such message raise `Undecodable`, nothing else."""
    with contextlib.suppress(Undecodable):
        assert decode(encoding + b"\0\0" + data, "pkg/Scan", parse("pkg/Scan", SCAN))


@given(st.text(max_size=200) | st.text(st.sampled_from('=ab/ \n[]<1#@"'), max_size=60))
def test_any_definition_is_parsed_or_refused(definition: str) -> None:
    """A text that is no definition raises `Undecodable`, nothing else."""
    with contextlib.suppress(Undecodable):
        assert "pkg/Scan" in parse("pkg/Scan", f"=== pkg/Scan\n{definition}")


JAZZY = get_typestore(Stores.ROS2_JAZZY)
STANDARD = (
    *("std_msgs/String", "builtin_interfaces/Time", "geometry_msgs/TwistStamped", "nav_msgs/Path"),
    *("sensor_msgs/LaserScan", "sensor_msgs/PointCloud2", "sensor_msgs/Image", "sensor_msgs/BatteryState"),
    "diagnostic_msgs/DiagnosticArray",
)
NUMBERS = ("int8", "uint8", "byte", "char", "int16", "uint16", "int32", "uint32", "int64", "uint64")
FLOATS = ("float32", "float64")
DTYPES = {"byte": "uint8", "char": "uint8"}


def rosbags_name(name: str) -> str:
    return name.replace("/", "/msg/")


def definitions(name: str, store: Typestore) -> str:
    """The definition of a type as the robot prints it."""
    whole = store.generate_msgdef(rosbags_name(name), ros_version=2)[0]
    rest = re.sub(r"=+\nMSG: (\w+)/(?:msg/)?(\w+)", r"=== \1/\2", whole)
    return f"=== {name}\n{rest}"


def drawn(data: st.DataObject, kind: str, store: Typestore, types: Types) -> Any:  # noqa: ANN401
    """A value of a type, as rosbags takes it."""
    draw = data.draw
    if kind == "string":
        return draw(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5))
    if kind == "bool":
        return draw(st.booleans())
    if kind in FLOATS:
        return draw(st.floats(width=int(kind[5:]), allow_nan=False))  # type: ignore[arg-type]
    if kind in NUMBERS:
        # rosbags 0.10 has signed bytes; those of ROS 2 are octets. Both agree up to 127.
        if kind == "byte":
            return draw(st.integers(0, 127))
        info = np.iinfo(DTYPES.get(kind, kind))
        return draw(st.integers(int(info.min), int(info.max)))
    values: dict[str, Any] = {field.name: drawn_field(data, field, store, types) for field in types[kind]}
    return store.types[rosbags_name(kind)](**values)


def drawn_field(data: st.DataObject, field: Field, store: Typestore, types: Types) -> object:
    if not field.array:
        return drawn(data, field.type, store, types)
    count = data.draw(st.integers(0, 2)) if field.length is None else field.length
    values = [drawn(data, field.type, store, types) for _ in range(count)]
    numbers = (*NUMBERS, *FLOATS, "bool")
    return np.array(values, dtype=DTYPES.get(field.type, field.type)) if field.type in numbers else values


def plain(value: Any, types: Types, kind: str) -> Any:  # noqa: ANN401
    """What rosbags read, in our parser's types."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, list):
        return [plain(item, types, kind) for item in value]
    if kind in types:
        return {one.name: plain(getattr(value, one.name), types, one.type) for one in types[kind]}
    return value


@pytest.mark.parametrize("name", STANDARD)
@settings(max_examples=10)
@given(little=st.booleans(), data=st.data())
def test_messages_are_read_as_rosbags_reads_them(name: str, little: bool, data: st.DataObject) -> None:
    """An independent implementation writes the bytes, and both read the same values from them."""
    types = parse(name, definitions(name, JAZZY))
    message = drawn(data, name, JAZZY, types)
    written = bytes(JAZZY.serialize_cdr(message, rosbags_name(name), little_endian=little))
    read = JAZZY.deserialize_cdr(written, rosbags_name(name))
    assert decode(written, name, types) == plain(read, types, name)


def test_rosbags_agrees_about_our_own_type() -> None:
    """Bounds and defaults are the part of the language that the standard types do not use."""
    store = get_typestore(Stores.EMPTY)
    own = SCAN.partition("=== std_msgs/Header")[0].partition("\n")[2]
    store.register(get_types_from_msg(own, "pkg/msg/Scan"))
    ours = [(field.name, field.array) for field in parse("pkg/Scan", SCAN)["pkg/Scan"]]
    assert [name for name, _ in ours] == [name for name, _ in store.fielddefs["pkg/msg/Scan"][1]]
