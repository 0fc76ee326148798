"""What values do the bytes of a ROS 2 message hold?

A publisher of ROS 2 sends only the name of its type, so the definitions come from the robot: the ``.msg`` files of the
packages in its image. https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html describes definitions, the
chapter on CDR of https://www.omg.org/spec/DDS-XTYPES/1.3 the bytes: each number is aligned to its size.
"""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, Any

from fleet.ros.rosmsg import Field, Reader, Undecodable

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from fleet.ros.rosmsg import Value

MARK = "=== "
"""Begins the line before each definition that `ros2_types.sh` prints: ``=== std_msgs/String``."""


Types = dict[str, tuple[Field, ...]]

_FORMATS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_BUILT_IN = {*_FORMATS, "string"}
_LINE = re.compile(r"([A-Za-z][\w/]*)(<=\d+)?(\[(<=)?(\d{0,9})\])?\s+([A-Za-z]\w*)\b\s*(.*)")
_BIG, _LITTLE, _BIG_2, _LITTLE_2 = b"\0\0", b"\0\1", b"\0\6", b"\0\7"
_LARGEST_ARRAY = 100_000_000  # of a fixed length; more is a mistake of the definition


def type_name(dds: str) -> str:
    """Return the short name of a type: ``std_msgs/String`` for ``std_msgs::msg::dds_::String_`` or ``std_msgs/msg/String``.

    Raises `Undecodable`.
    """
    match = re.fullmatch(r"(\w+)::msg::dds_::(\w+)_", dds) or re.fullmatch(r"(\w+)/msg/(\w+)", dds)
    if not match:
        raise Undecodable(f"{dds} is not a message type of ROS")
    return "/".join(match.groups())


def parse(type_name: str, text: str) -> Types:
    """Return the fields of every message type in the output of `ros2_types.sh`. Raises `Undecodable`.

    ``type_name`` and all types that it uses must be in it.
    """
    found = re.split(rf"^{MARK}(\S+)\n", text.replace("\r\n", "\n"), flags=re.MULTILINE)[1:]
    types = {
        name: tuple(_fields(lines, package=name.partition("/")[0]))
        for name, lines in zip(found[::2], found[1::2], strict=True)
    }
    if type_name not in types:
        raise Undecodable(f"no running container of the robot has a definition of {type_name}")
    for name, fields in types.items():
        for field in fields:
            if field.type not in types and field.type not in _BUILT_IN:
                raise Undecodable(
                    f"{name} uses {field.type}, and no running container has a definition of it"
                )
    return types


def _fields(text: str, *, package: str) -> Iterator[Field]:
    for line in map(str.strip, text.splitlines()):
        if not line or line.startswith(("#", "@")):
            continue
        match = _LINE.match(line)
        if not match:
            raise Undecodable(f"a message definition has the line {line[:80]!r}")
        kind, _, array, bounded, length, name, after = match.groups()
        if after.startswith("="):  # a constant, which no message carries
            continue
        if kind == "wstring":
            raise Undecodable(f"the field {name} is a wstring, and middlewares disagree about its bytes")
        full = kind if "/" in kind or kind in _BUILT_IN else f"{package}/{kind}"
        fixed = int(length) if length and not bounded else None
        if fixed is not None and fixed > _LARGEST_ARRAY:
            raise Undecodable(f"the field {name} is an array of {fixed} elements")
        yield Field(name=name, type=full.replace("/msg/", "/"), array=bool(array), length=fixed)


def decode(data: bytes, type_name: str, types: Mapping[str, Sequence[Field]]) -> dict[str, Value]:
    """Return the values of a message, by field. Raises `Undecodable`."""
    reader = _Reader(data, types)
    message = reader.message(type_name, depth=0)
    if reader.left > 3:  # up to three bytes fill the last word
        raise Undecodable(f"a message of {type_name} has {reader.left} bytes more than its definition says")
    return message


class _Reader(Reader):
    """Each number is aligned to its size; the first two bytes say in which order its bytes are."""

    def __init__(self, data: bytes, types: Mapping[str, Sequence[Field]]) -> None:
        encoding = data[:2]
        if len(data) < 4 or encoding not in (_BIG, _LITTLE, _BIG_2, _LITTLE_2):
            raise Undecodable("a message is not in plain CDR, as messages of ROS are")
        self._order = "<" if encoding in (_LITTLE, _LITTLE_2) else ">"
        self._widest = 4 if encoding in (_BIG_2, _LITTLE_2) else 8
        super().__init__(data[4:], types)

    def message(self, type_name: str, *, depth: int) -> dict[str, Value]:
        if not self._types[type_name]:
            self._bytes(1)  # IDL has no empty structures: ROS puts a byte into them
        return super().message(type_name, depth=depth)

    def field(self, field: Field, *, depth: int) -> Value:
        if not field.array:
            return self._value(field.type, depth=depth)
        length = self._length() if field.length is None else field.length
        layout = _FORMATS.get(field.type)
        if layout == "B":
            return self._bytes(length)
        if layout:
            return list(self._numbers(layout, length)) if length else []
        if length > self.left:
            raise Undecodable(f"a message ends before the {length} elements of {field.name}")
        return [self._value(field.type, depth=depth) for _ in range(length)]

    def _value(self, kind: str, *, depth: int) -> Value:
        self._count_value()
        if kind in _FORMATS:
            value: Value = self._numbers(_FORMATS[kind], 1)[0]
            return value
        if kind == "string":
            return self._bytes(self._length()).removesuffix(b"\0").decode(errors="replace")
        return self.message(kind, depth=depth + 1)

    def _length(self) -> int:
        return int(self._numbers("I", 1)[0])

    def _numbers(self, layout: str, count: int) -> tuple[Any, ...]:
        width = struct.calcsize(f"={layout}")
        self._bytes(-self._at % min(width, self._widest))
        return struct.unpack(f"{self._order}{count}{layout}", self._bytes(width * count))
