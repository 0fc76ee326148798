"""What do the bytes of an RTPS datagram say, and which bytes does a listener send?

RTPS carries the messages of DDS, which most middlewares of ROS 2 use: https://www.omg.org/spec/DDSI-RTPS/2.5. Anybody in
the network can send such datagrams. So `read` never raises: a part that makes no sense is left out, and the memory for
an answer is a few times the datagram.
"""

from __future__ import annotations

import contextlib
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

GROUP = "239.255.0.1"
"""The multicast address of discovery."""

PARTICIPANTS = 10
"""Participants of one robot that are looked for by unicast: each has a port of its own, and most robots have fewer."""

ANNOUNCER = b"\0\1\0\xc2"
PUBLICATIONS, PUBLICATIONS_READER = b"\0\0\3\xc2", b"\0\0\3\xc7"
SUBSCRIPTIONS, SUBSCRIPTIONS_READER = b"\0\0\4\xc2", b"\0\0\4\xc7"
OUR_READER = b"\0\0\1\x04"
"""The entities of a participant that are used here: the built-in ones of the specification, and our own reader."""

_VENDOR = b"\1\x42"  # not one of those that OMG has given out
_HEADER = b"RTPS\2\3" + _VENDOR
_VENDORS = {
    b"\1\x01": "RTI Connext",
    b"\1\x0f": "Fast DDS",
    b"\1\x10": "Cyclone DDS",
    b"\1\x12": "RustDDS",
    b"\1\x14": "Dust DDS",
}
_PAD, _ACKNACK, _HEARTBEAT, _GAP, _TIMESTAMP, _DESTINATION = 0x01, 0x06, 0x07, 0x08, 0x09, 0x0E
_DATA, _FRAGMENT = 0x15, 0x16
_LITTLE, _FINAL, _INLINE_QOS, _HAS_DATA, _HAS_KEY = 1, 2, 2, 4, 8
_END, _LEASE, _TOPIC, _TYPE, _DOMAIN, _VERSION, _VENDOR_ID = 0x01, 0x02, 0x05, 0x07, 0x0F, 0x15, 0x16
_RELIABILITY, _DURABILITY, _LOCATOR, _DATA_LOCATOR, _META_LOCATOR = 0x1A, 0x1D, 0x2F, 0x31, 0x32
_PARTICIPANT, _ENDPOINTS, _PROPERTIES, _GUID, _NAME, _KEY_HASH, _STATUS = (
    0x50,
    0x58,
    0x59,
    0x5A,
    0x62,
    0x70,
    0x71,
)
_IDENTITY_TOKEN = 0x1001
_LEASE_SECONDS = 20  # of our own announcement

Place: TypeAlias = "tuple[str, int]"
"""An IPv4 address and a port."""


@dataclass(frozen=True, kw_only=True)
class Data:
    """A sample of a writer. ``gone`` is the GUID of a thing that has ended, or b""."""

    writer: bytes
    number: int
    payload: bytes
    gone: bytes = b""


@dataclass(frozen=True, kw_only=True)
class Fragment:
    """A part of a sample: the pieces from ``first`` on, counted from 1, of ``size`` bytes each, out of ``total`` bytes."""

    writer: bytes
    number: int
    first: int
    size: int
    total: int
    payload: bytes


@dataclass(frozen=True, kw_only=True)
class Heartbeat:
    """The numbers of the samples that a writer still has. ``final``: it wants an answer only if some are missing."""

    writer: bytes
    first: int
    last: int
    final: bool


@dataclass(frozen=True, kw_only=True)
class Gap:
    """A writer will not send the samples before ``base``, as far as they are missing from ``first`` on."""

    writer: bytes
    first: int
    base: int


@dataclass(frozen=True, kw_only=True)
class Acknack:
    """A reader has all samples of our ``writer`` before ``base``."""

    writer: bytes
    base: int


Part: TypeAlias = "Data | Fragment | Heartbeat | Gap | Acknack"


@dataclass(frozen=True, kw_only=True)
class Packet:
    """A datagram: who sent it, and its parts."""

    prefix: bytes
    parts: tuple[Part, ...]


@dataclass(frozen=True, kw_only=True)
class Participant:
    """What a participant announces about itself. ``lease`` is in seconds; ``domain`` is None if it does not say."""

    prefix: bytes
    domain: int | None
    vendor: str
    meta: tuple[Place, ...]
    data: tuple[Place, ...]
    lease: float
    secured: bool


@dataclass(frozen=True, kw_only=True)
class Writer:
    """A publisher of a topic. ``topic`` and ``type`` are DDS names, such as ``rt/time``."""

    guid: bytes
    topic: str
    type: str
    reliable: bool
    durable: bool


def read(datagram: bytes) -> Packet | None:
    """Return what a datagram says, without the parts that make no sense; None if it is not RTPS."""
    if len(datagram) < 20 or datagram[:4] != b"RTPS":
        return None
    return Packet(prefix=datagram[8:20], parts=tuple(_parts(datagram)))


def _parts(datagram: bytes) -> Iterator[Part]:
    at = 20
    while at + 4 <= len(datagram):
        kind, flags = datagram[at], datagram[at + 1]
        order = "<" if flags & _LITTLE else ">"
        (length,) = struct.unpack_from(f"{order}H", datagram, at + 2)
        if not length and kind not in (_PAD, _TIMESTAMP):
            length = len(datagram) - at - 4  # the last one may leave it out
        body = datagram[at + 4 : at + 4 + length]
        at += 4 + length
        with contextlib.suppress(struct.error):
            if part := _part(kind, flags, order, body):
                yield part


def _part(kind: int, flags: int, order: str, body: bytes) -> Part | None:
    if kind == _DATA:
        return _data(flags, order, body)
    if kind == _FRAGMENT:
        return _fragment(flags, order, body)
    if kind == _HEARTBEAT:
        first, last = _number(order, body, 8), _number(order, body, 16)
        final = bool(flags & _FINAL)
        return Heartbeat(writer=body[4:8], first=first, last=last, final=final) if first > 0 else None
    if kind == _GAP:
        return Gap(writer=body[4:8], first=_number(order, body, 8), base=_number(order, body, 16))
    if kind == _ACKNACK:
        return Acknack(writer=body[4:8], base=_number(order, body, 8))
    return None


def _number(order: str, body: bytes, at: int) -> int:
    high, low = struct.unpack_from(f"{order}iI", body, at)
    return (int(high) << 32) + int(low)


def _data(flags: int, order: str, body: bytes) -> Data | None:
    number = _number(order, body, 12)
    if number < 1:
        return None
    inline, at = _inline(flags, order, body)
    status = (inline.raw(_STATUS) or bytes(4))[3:4]
    gone = b""
    if status in (b"\1", b"\2", b"\3"):  # disposed, unregistered, or both
        key = parameters(body[at:])
        gone = inline.raw(_KEY_HASH) or key.raw(_GUID) or key.raw(_PARTICIPANT)
    payload = body[at:] if flags & _HAS_DATA else b""
    return Data(writer=body[8:12], number=number, payload=payload, gone=gone)


def _fragment(flags: int, order: str, body: bytes) -> Fragment | None:
    number = _number(order, body, 12)
    first, _, size, total = struct.unpack_from(f"{order}IHHI", body, 20)
    _, at = _inline(flags, order, body)
    if number < 1 or first < 1 or size < 1 or not body[at:]:
        return None
    return Fragment(writer=body[8:12], number=number, first=first, size=size, total=total, payload=body[at:])


def _inline(flags: int, order: str, body: bytes) -> tuple[Parameters, int]:
    """Return the quality of service that stands before a payload, and the place of the payload."""
    (skip,) = struct.unpack_from(f"{order}H", body, 2)
    return (
        _list(order, body, 4 + int(skip)) if flags & _INLINE_QOS else (Parameters(order, {}), 4 + int(skip))
    )


class Parameters:
    """A parameter list: for each identifier, its values as bytes."""

    def __init__(self, order: str, values: dict[int, list[bytes]]) -> None:
        self._order, self._values = order, values

    def raw(self, name: int) -> bytes:
        """Return the first value of a parameter, b"" if it is missing."""
        return next(iter(self._values.get(name, ())), b"")

    def number(self, name: int) -> int | None:
        """Return a number of 32 bits."""
        raw = self.raw(name)
        return int(struct.unpack_from(f"{self._order}I", raw)[0]) if len(raw) >= 4 else None

    def text(self, name: int) -> str:
        """Return a string."""
        return self.raw(name)[4 : 4 + (self.number(name) or 0)].rstrip(b"\0").decode(errors="replace")

    def places(self, name: int) -> tuple[Place, ...]:
        """Return the IPv4 addresses among locators. Shared memory and IPv6 are no use to a listener elsewhere."""
        found = []
        for raw in self._values.get(name, ()):
            if len(raw) == 24 and struct.unpack_from(f"{self._order}i", raw) == (1,):
                (port,) = struct.unpack_from(f"{self._order}I", raw, 4)
                found.append((".".join(map(str, raw[20:24])), int(port)))
        return tuple(place for place in found if 0 < place[1] < 65536)

    def __contains__(self, name: int) -> bool:
        return name in self._values


def parameters(payload: bytes) -> Parameters:
    """Return the parameter list of a discovery message; a truncated one up to where it ends."""
    return _list("<" if payload[1:2] == b"\3" else ">", payload, 4)[0]


def _list(order: str, raw: bytes, at: int) -> tuple[Parameters, int]:
    """Return the parameter list in ``raw`` from ``at`` on, and the place where it ends."""
    values: dict[int, list[bytes]] = {}
    while at + 4 <= len(raw):
        name, length = struct.unpack_from(f"{order}HH", raw, at)
        if name == _END:
            return Parameters(order, values), at + 4
        values.setdefault(name, []).append(raw[at + 4 : at + 4 + length])
        at += 4 + length
    return Parameters(order, values), len(raw)


def participant(payload: bytes, *, prefix: bytes) -> Participant:
    """Return what the announcement of a participant says; ``prefix`` is that of its datagram."""
    said = parameters(payload)
    return Participant(
        prefix=said.raw(_PARTICIPANT)[:12] or prefix,
        domain=said.number(_DOMAIN),
        vendor=_VENDORS.get(said.raw(_VENDOR_ID)[:2], "another DDS"),
        meta=said.places(_META_LOCATOR),
        data=said.places(_DATA_LOCATOR),
        lease=float(said.number(_LEASE) or _LEASE_SECONDS),
        secured=_IDENTITY_TOKEN in said,
    )


def writer(payload: bytes) -> Writer | None:
    """Return the publisher that a discovery message is about, None if it does not say enough."""
    said = parameters(payload)
    guid, topic, kind = said.raw(_GUID), said.text(_TOPIC), said.text(_TYPE)
    if len(guid) != 16 or not topic or not kind:
        return None
    # Kinds: 2 is reliable (1 best effort), 1 and more keep messages for those who come later (0 volatile).
    return Writer(
        guid=guid,
        topic=topic,
        type=kind,
        reliable=said.number(_RELIABILITY) == 2,
        durable=(said.number(_DURABILITY) or 0) > 0,
    )


def port(domain: int, offset: int) -> int:
    """Return a port of a domain: offset 0 is for multicast discovery, 10 + 2 i for discovery of its participant i."""
    return 7400 + 250 * domain + offset


def announcement(prefix: bytes, *, domain: int, place: Place) -> bytes:
    """Return the datagram that announces a listener which receives everything at ``place``."""
    said = _parameter(_VERSION, b"\2\3") + _parameter(_VENDOR_ID, _VENDOR)
    said += _parameter(_PARTICIPANT, prefix + b"\0\0\1\xc1")
    said += _parameter(_LEASE, struct.pack("<iI", _LEASE_SECONDS, 0))
    # It announces itself (1, 2) and its subscription (16), and reads publications (8).
    said += _parameter(_ENDPOINTS, struct.pack("<I", 1 | 2 | 8 | 16))
    said += _parameter(_DOMAIN, struct.pack("<I", domain)) + _parameter(_NAME, _string("fab listen"))
    said += _parameter(_META_LOCATOR, _locator(place)) + _parameter(_DATA_LOCATOR, _locator(place))
    return _HEADER + prefix + _sample(bytes(4), ANNOUNCER, said)


def farewell(prefix: bytes) -> bytes:
    """Return the datagram that says that a listener has left, so that nobody keeps messages for it."""
    guid = prefix + b"\0\0\1\xc1"
    quality = _parameter(_KEY_HASH, guid) + _parameter(_STATUS, b"\0\0\0\3") + struct.pack("<HH", _END, 0)
    key = b"\0\3\0\0" + _parameter(_PARTICIPANT, guid) + struct.pack("<HH", _END, 0)
    body = b"\0\0\x10\0" + bytes(4) + ANNOUNCER + struct.pack("<iI", 0, 2) + quality + key
    return _HEADER + prefix + _submessage(_DATA, body, flags=_LITTLE | _INLINE_QOS | _HAS_KEY)


def to(prefix: bytes, peer: bytes, *parts: bytes) -> bytes:
    """Return a datagram with parts for one peer."""
    return _HEADER + prefix + _submessage(_DESTINATION, peer) + b"".join(parts)


def subscription(prefix: bytes, *, topic: str, kind: str, durable: bool, place: Place) -> bytes:
    """Return the part that announces a reader of a topic. ``durable``: it wants the messages of before, so it is reliable."""
    said = _parameter(_TOPIC, _string(topic)) + _parameter(_TYPE, _string(kind))
    said += _parameter(_GUID, prefix + OUR_READER)
    said += _parameter(_RELIABILITY, struct.pack("<IiI", 2 if durable else 1, 0, 0))
    said += _parameter(_DURABILITY, struct.pack("<I", 1 if durable else 0))
    said += _parameter(_LOCATOR, _locator(place))
    return _sample(SUBSCRIPTIONS_READER, SUBSCRIPTIONS, said)


def heartbeat(count: int) -> bytes:
    """Return the part that says: our one subscription can be asked for."""
    body = SUBSCRIPTIONS_READER + SUBSCRIPTIONS + struct.pack("<iIiII", 0, 1, 0, 1, count)
    return _submessage(_HEARTBEAT, body)


def acknack(
    reader: bytes, writer: bytes, *, base: int, missing: Collection[int], count: int, final: bool
) -> bytes:
    """Return the part that has all before ``base`` and asks for the ``missing`` numbers, at most 255 after it.

    If it is not ``final``, the writer answers with a heartbeat, and Cyclone DDS does so at once.
    """
    bits = max((number - base + 1 for number in missing), default=0)
    words = [0] * -(-bits // 32)
    for number in missing:
        words[(number - base) // 32] |= 1 << (31 - (number - base) % 32)
    numbers = struct.pack(f"<iII{len(words)}I", base >> 32, base & 0xFFFFFFFF, bits, *words)
    flags = _LITTLE | (_FINAL if final else 0)
    return _submessage(_ACKNACK, reader + writer + numbers + struct.pack("<I", count), flags=flags)


def _sample(reader: bytes, writer: bytes, said: bytes) -> bytes:
    body = b"\0\0\x10\0" + reader + writer + struct.pack("<iI", 0, 1)
    payload = b"\0\3\0\0" + said + struct.pack("<HH", _END, 0)
    return _submessage(_DATA, body + payload, flags=_LITTLE | _HAS_DATA)


def _submessage(kind: int, body: bytes, *, flags: int = _LITTLE) -> bytes:
    return struct.pack("<BBH", kind, flags, len(body)) + body


def _parameter(name: int, value: bytes) -> bytes:
    padded = value + bytes(-len(value) % 4)
    return struct.pack("<HH", name, len(padded)) + padded


def _string(value: str) -> bytes:
    raw = value.encode() + b"\0"
    return struct.pack("<I", len(raw)) + raw


def _locator(place: Place) -> bytes:
    return struct.pack("<II", 1, place[1]) + bytes(12) + bytes(map(int, place[0].split(".")))
