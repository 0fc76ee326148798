"""What values do the bytes of a ROS 1 message hold?

A publisher sends its message definition along (``message_definition`` of the TCPROS connection header), so any topic
can be read without ROS and without its message packages. https://wiki.ros.org/msg describes definitions,
https://wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes the bytes: little endian, no padding.
"""

from __future__ import annotations

import json
import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

DEEPEST = 32  # messages within messages
MOST_VALUES = 1_000_000  # in one message; an array of numbers counts as one
SHOWN = 32  # items of an array, where a message is shown as text

Value: TypeAlias = "bool | int | float | str | bytes | Time | list[Value] | dict[str, Value]"


class Undecodable(ValueError):
    """A definition that is not valid, or bytes that do not match it."""


class Time(NamedTuple):
    """A ROS ``time`` or ``duration``."""

    secs: int
    nsecs: int


@dataclass(frozen=True, kw_only=True)
class Field:
    """One line of a definition. ``type`` is built in or ``package/Name``; ``length`` is None for ``[]`` and ``[<=5]``."""

    name: str
    type: str
    array: bool
    length: int | None


_FORMATS = {
    "bool": "?",
    "int8": "b",
    "byte": "b",
    "uint8": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_TIMES = {"time": "<II", "duration": "<ii"}
_BUILT_IN = {*_FORMATS, *_TIMES, "string"}
_SEPARATOR = re.compile(r"^=+\s*\nMSG:\s*(\S+)\s*$", re.MULTILINE)
_LINE = re.compile(r"([A-Za-z][\w/]*)(\[(\d{0,9})\])?\s+([A-Za-z]\w*)\s*(=|#|$)")


def parse(type_name: str, definition: str) -> dict[str, tuple[Field, ...]]:
    """Return the fields of every message type in a definition, ``type_name``'s own first. Raises `Undecodable`."""
    own, *rest = _SEPARATOR.split(definition.replace("\r\n", "\n"))
    texts = {type_name: own, **dict(zip(rest[::2], rest[1::2], strict=True))}
    types = {name: tuple(_fields(text, package=name.partition("/")[0])) for name, text in texts.items()}
    known = _BUILT_IN | set(types)
    for name, fields in types.items():
        for field in fields:
            if field.type not in known:
                raise Undecodable(f"the definition of {name} uses {field.type} and does not define it")
    return types


def _fields(text: str, *, package: str) -> Iterator[Field]:
    for line in map(str.strip, text.splitlines()):
        if not line or line.startswith("#"):
            continue
        match = _LINE.match(line)
        if not match:
            raise Undecodable(f"a message definition has the line {line[:80]!r}")
        kind, array, length, name, after = match.groups()
        if after != "=":  # that would be a constant, which no message carries
            full = "std_msgs/Header" if kind == "Header" else kind
            full = full if "/" in full or full in _BUILT_IN else f"{package}/{full}"
            yield Field(name=name, type=full, array=bool(array), length=int(length) if length else None)


def decode(data: bytes, type_name: str, types: Mapping[str, Sequence[Field]]) -> dict[str, Value]:
    """Return the values of a message, by field. Raises `Undecodable`."""
    reader = _Reader(data, types)
    message = reader.message(type_name, depth=0)
    if reader.left:
        raise Undecodable(f"a message of {type_name} has {reader.left} bytes more than its definition says")
    return message


class Reader:
    """Reads a message's bytes in order; refuses to read past their end, too deep, or too many values.

    Each version of ROS has its own ``field``: how numbers, texts and arrays lie in the bytes.
    """

    def __init__(self, data: bytes, types: Mapping[str, Sequence[Field]]) -> None:
        self._data, self._types = data, types
        self._at = self._count = 0

    @property
    def left(self) -> int:
        """How many bytes are not read yet."""
        return len(self._data) - self._at

    def message(self, type_name: str, *, depth: int) -> dict[str, Value]:
        """Return the values of the next message, by field. Raises `Undecodable`."""
        if depth > DEEPEST:
            raise Undecodable(f"{type_name} nests more than {DEEPEST} messages deep")
        return {field.name: self.field(field, depth=depth) for field in self._types[type_name]}

    def field(self, field: Field, *, depth: int) -> Value:
        """Return the value of the next field. Raises `Undecodable`."""
        raise NotImplementedError

    def _count_value(self) -> None:
        self._count += 1
        if self._count > MOST_VALUES:
            raise Undecodable(f"a message has more than {MOST_VALUES} values")

    def _bytes(self, count: int) -> bytes:
        if count > self.left:
            raise Undecodable(f"a message ends {count - self.left} bytes too early")
        self._at += count
        return self._data[self._at - count : self._at]


class _Reader(Reader):
    """Little endian, and no padding."""

    def field(self, field: Field, *, depth: int) -> Value:
        if not field.array:
            return self._value(field.type, depth=depth)
        length = self._length() if field.length is None else field.length
        if field.type in {"uint8", "char"}:
            return self._bytes(length)
        if field.type in _FORMATS:
            return list(self._unpack(f"<{length}{_FORMATS[field.type]}"))
        return [self._value(field.type, depth=depth) for _ in range(length)]

    def _value(self, kind: str, *, depth: int) -> Value:
        self._count_value()
        if kind in _FORMATS:
            value: Value = self._unpack(f"<{_FORMATS[kind]}")[0]
            return value
        if kind in _TIMES:
            return Time(*self._unpack(_TIMES[kind]))
        if kind == "string":
            return self._bytes(self._length()).decode(errors="replace")
        return self.message(kind, depth=depth + 1)

    def _length(self) -> int:
        return int(self._unpack("<I")[0])

    def _unpack(self, layout: str) -> tuple[Any, ...]:
        try:
            return struct.unpack(layout, self._bytes(struct.calcsize(layout)))
        except struct.error as problem:  # an array longer than memory can address
            raise Undecodable(f"a message cannot be read: {problem}") from problem


def text(message: Mapping[str, Value]) -> str:
    """Return a message as ``rostopic echo`` shows it, with long arrays cut short."""
    return "\n".join(_lines(message))


def _lines(message: Mapping[str, Value]) -> Iterator[str]:
    for name, value in message.items():
        if isinstance(value, dict | Time):
            yield f"{name}:"
            yield from ("  " + line for line in _lines(value if isinstance(value, dict) else value._asdict()))
        elif isinstance(value, list) and value and isinstance(value[0], dict | Time):
            yield f"{name}:"
            yield from _items(value)
        else:
            yield f"{name}: {_plain(value)}"


def _items(values: Sequence[Value]) -> Iterator[str]:
    for value in values[:SHOWN]:
        item = value._asdict() if isinstance(value, Time) else value
        yield "  -"
        yield from ("    " + line for line in (_lines(item) if isinstance(item, dict) else ()))
    if len(values) > SHOWN:
        yield f"  # and {len(values) - SHOWN} more"


def _plain(value: Value) -> str:
    if isinstance(value, str):
        quoted = json.dumps(value, ensure_ascii=False)
        return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in quoted)
    if isinstance(value, bytes | list):
        shown = ", ".join(_plain(item) for item in value[:SHOWN])
        more = f", ... {len(value) - SHOWN} more" if len(value) > SHOWN else ""
        return f"[{shown}{more}]"
    return str(value)
