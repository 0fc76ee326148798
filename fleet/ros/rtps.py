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

from fleet.ros import rtps_discovery as discovery

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from fleet.ros.rtps_discovery import Place

GROUP = "239.255.0.1"
"""The multicast address of discovery."""

PARTICIPANTS = 10
"""Participants of one robot that are looked for by unicast: each has a port of its own, and most robots have fewer."""

ANNOUNCER = b"\0\1\0\xc2"
PUBLICATIONS, PUBLICATIONS_READER = b"\0\0\3\xc2", b"\0\0\3\xc7"
SUBSCRIPTIONS, SUBSCRIPTIONS_READER = b"\0\0\4\xc2", b"\0\0\4\xc7"
"""The built-in entities of a participant that are used here."""

_VENDOR = b"\1\x42"  # not one of those that OMG has given out
_HEADER = b"RTPS\2\3" + _VENDOR
_PAD, _ACKNACK, _HEARTBEAT, _GAP, _TIMESTAMP, _DESTINATION = 0x01, 0x06, 0x07, 0x08, 0x09, 0x0E
_DATA, _FRAGMENT = 0x15, 0x16
_LITTLE, _FINAL, _INLINE_QOS, _HAS_DATA, _HAS_KEY = 1, 2, 2, 4, 8


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
    """Return the number of a sample. Raises ``struct.error``, also for those of which no writer gets to the next."""
    high, low = struct.unpack_from(f"{order}iI", body, at)
    if not 0 <= high < 0x7FFFFFFF:
        raise struct.error("no number of a sample")
    return (int(high) << 32) + int(low)


def _data(flags: int, order: str, body: bytes) -> Data | None:
    number = _number(order, body, 12)
    if number < 1:
        return None
    inline, at = _inline(flags, order, body)
    status = (inline.raw(discovery.STATUS) or bytes(4))[3:4]
    gone = b""
    if status in (b"\1", b"\2", b"\3"):  # disposed, unregistered, or both
        key = discovery.parameters(body[at:])
        gone = inline.raw(discovery.KEY_HASH) or key.raw(discovery.GUID) or key.raw(discovery.PARTICIPANT)
    payload = body[at:] if flags & _HAS_DATA else b""
    return Data(writer=body[8:12], number=number, payload=payload, gone=gone)


def _fragment(flags: int, order: str, body: bytes) -> Fragment | None:
    number = _number(order, body, 12)
    first, _, size, total = struct.unpack_from(f"{order}IHHI", body, 20)
    _, at = _inline(flags, order, body)
    if number < 1 or first < 1 or size < 1 or not body[at:]:
        return None
    return Fragment(writer=body[8:12], number=number, first=first, size=size, total=total, payload=body[at:])


def _inline(flags: int, order: str, body: bytes) -> tuple[discovery.Parameters, int]:
    """Return the quality of service that stands before a payload, and the place of the payload."""
    (skip,) = struct.unpack_from(f"{order}H", body, 2)
    return (
        discovery.listed(order, body, 4 + int(skip))
        if flags & _INLINE_QOS
        else (discovery.Parameters(order, {}), 4 + int(skip))
    )


def port(domain: int, offset: int) -> int:
    """Return a port of a domain: offset 0 is for multicast discovery, 10 + 2 i for discovery of its participant i."""
    return 7400 + 250 * domain + offset


def announcement(prefix: bytes, *, domain: int, place: Place) -> bytes:
    """Return the datagram that announces a listener which receives everything at ``place``."""
    said = _parameter(discovery.VERSION, b"\2\3") + _parameter(discovery.VENDOR, _VENDOR)
    said += _parameter(discovery.PARTICIPANT, prefix + b"\0\0\1\xc1")
    said += _parameter(discovery.LEASE, struct.pack("<iI", discovery.USUAL_LEASE, 0))
    # It announces itself (1, 2) and its subscriptions (16), and reads the publications and subscriptions of others (8, 32).
    said += _parameter(discovery.ENDPOINTS, struct.pack("<I", 1 | 2 | 8 | 16 | 32))
    said += _parameter(discovery.DOMAIN, struct.pack("<I", domain)) + _parameter(
        discovery.NAME, _string("fab listen")
    )
    said += _parameter(discovery.META_LOCATOR, _locator(place)) + _parameter(
        discovery.DATA_LOCATOR, _locator(place)
    )
    return _HEADER + prefix + _sample(bytes(4), ANNOUNCER, said)


def farewell(prefix: bytes) -> bytes:
    """Return the datagram that says that a listener has left, so that nobody keeps messages for it."""
    guid = prefix + b"\0\0\1\xc1"
    quality = (
        _parameter(discovery.KEY_HASH, guid)
        + _parameter(discovery.STATUS, b"\0\0\0\3")
        + struct.pack("<HH", discovery.END, 0)
    )
    key = b"\0\3\0\0" + _parameter(discovery.PARTICIPANT, guid) + struct.pack("<HH", discovery.END, 0)
    body = b"\0\0\x10\0" + bytes(4) + ANNOUNCER + struct.pack("<iI", 0, 2) + quality + key
    return _HEADER + prefix + _submessage(_DATA, body, flags=_LITTLE | _INLINE_QOS | _HAS_KEY)


def to(prefix: bytes, peer: bytes, *parts: bytes) -> bytes:
    """Return a datagram with parts for one peer."""
    return _HEADER + prefix + _submessage(_DESTINATION, peer) + b"".join(parts)


def reader(number: int) -> bytes:
    """Return the entity of one of our readers: the numbers are those of our subscriptions, from 1 on."""
    return b"\0" + struct.pack(">H", number) + b"\x04"


def subscription(prefix: bytes, *, number: int, topic: str, kind: str, durable: bool, place: Place) -> bytes:
    """Return the part that announces a reader of a topic. ``durable``: it wants the messages of before, so it is reliable."""
    said = _parameter(discovery.TOPIC, _string(topic)) + _parameter(discovery.TYPE, _string(kind))
    said += _parameter(discovery.GUID, prefix + reader(number))
    said += _parameter(discovery.RELIABILITY, struct.pack("<IiI", 2 if durable else 1, 0, 0))
    said += _parameter(discovery.DURABILITY, struct.pack("<I", 1 if durable else 0))
    said += _parameter(discovery.LOCATOR, _locator(place))
    return _sample(SUBSCRIPTIONS_READER, SUBSCRIPTIONS, said, number=number)


def heartbeat(count: int, *, last: int) -> bytes:
    """Return the part that says: our subscriptions, up to this number, can be asked for."""
    body = SUBSCRIPTIONS_READER + SUBSCRIPTIONS + struct.pack("<iIiII", 0, 1, 0, last, count)
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


def _sample(reader: bytes, writer: bytes, said: bytes, *, number: int = 1) -> bytes:
    body = b"\0\0\x10\0" + reader + writer + struct.pack("<iI", 0, number)
    payload = b"\0\3\0\0" + said + struct.pack("<HH", discovery.END, 0)
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
