"""What do participants of DDS say about themselves, their publishers and their subscribers?

Discovery sends lists of parameters: https://www.omg.org/spec/DDSI-RTPS/2.5, chapters 8.5 and 9.6. Anybody in the network can
send such lists, so nothing here raises: what makes no sense is left out.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from math import inf
from typing import TypeAlias

from fleet.ros.quality import Quality

END, LEASE, TOPIC, TYPE, DOMAIN, VERSION, VENDOR = 0x01, 0x02, 0x05, 0x07, 0x0F, 0x15, 0x16
RELIABILITY, LIVELINESS, DURABILITY, DEADLINE = 0x1A, 0x1B, 0x1D, 0x23
LOCATOR, DATA_LOCATOR, META_LOCATOR = 0x2F, 0x31, 0x32
PARTICIPANT, ENDPOINTS, GUID, NAME, KEY_HASH, STATUS = 0x50, 0x58, 0x5A, 0x62, 0x70, 0x71
IDENTITY_TOKEN = 0x1001
"""The identifiers of parameters."""

USUAL_LEASE = 20
"""Seconds that a participant may be silent, if it does not say."""

LONGEST_NAME = 256
"""Characters of a topic or a type; Fast DDS allows 255. We send these names too, and a part has 64 kB."""

MOST_PLACES = 32
"""Addresses of a participant that are used: a robot has one for each interface."""

_VENDORS = {
    b"\1\x01": "RTI Connext",
    b"\1\x0f": "Fast DDS",
    b"\1\x10": "Cyclone DDS",
    b"\1\x12": "RustDDS",
    b"\1\x14": "Dust DDS",
}
_RELIABLE = 2  # 1 is best effort

Place: TypeAlias = "tuple[str, int]"
"""An IPv4 address and a port."""


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
class Endpoint:
    """A publisher or a subscriber of a topic. ``topic`` and ``type`` are DDS names, such as ``rt/time``."""

    guid: bytes
    topic: str
    type: str
    quality: Quality

    @property
    def keeps(self) -> bool:
        """Whether a publisher keeps its messages for those who come later, and sends them again."""
        return self.quality.reliable and self.quality.durability > 0


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

    def seconds(self, name: int, *, at: int = 0) -> float:
        """Return a duration, which is without end if it is missing."""
        raw = self.raw(name)
        if len(raw) < at + 8:
            return inf
        seconds, fraction = struct.unpack_from(f"{self._order}iI", raw, at)
        return inf if seconds == 0x7FFFFFFF else int(seconds) + int(fraction) / 2**32

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
        return tuple(place for place in found if 0 < place[1] < 65536)[:MOST_PLACES]

    def __contains__(self, name: int) -> bool:
        return name in self._values


def parameters(payload: bytes) -> Parameters:
    """Return the parameter list of a discovery message; a truncated one up to where it ends."""
    return listed("<" if payload[1:2] == b"\3" else ">", payload, 4)[0]


def listed(order: str, raw: bytes, at: int) -> tuple[Parameters, int]:
    """Return the parameter list in ``raw`` from ``at`` on, and the place where it ends."""
    values: dict[int, list[bytes]] = {}
    while at + 4 <= len(raw):
        name, length = struct.unpack_from(f"{order}HH", raw, at)
        if name == END:
            return Parameters(order, values), at + 4
        values.setdefault(name, []).append(raw[at + 4 : at + 4 + length])
        at += 4 + length
    return Parameters(order, values), len(raw)


def participant(payload: bytes, *, prefix: bytes) -> Participant:
    """Return what the announcement of a participant says; ``prefix`` is that of its datagram."""
    said = parameters(payload)
    return Participant(
        prefix=said.raw(PARTICIPANT)[:12] or prefix,
        domain=said.number(DOMAIN),
        vendor=_VENDORS.get(said.raw(VENDOR)[:2], "another DDS"),
        meta=said.places(META_LOCATOR),
        data=said.places(DATA_LOCATOR),
        lease=float(said.number(LEASE) or USUAL_LEASE),
        secured=IDENTITY_TOKEN in said,
    )


def endpoint(payload: bytes, *, publishes: bool) -> Endpoint | None:
    """Return the publisher or subscriber that a discovery message is about, None if it does not say enough.

    A quality that is not said is the default of DDS: only publishers are reliable.
    """
    said = parameters(payload)
    guid, topic, kind = said.raw(GUID), said.text(TOPIC), said.text(TYPE)
    if len(guid) != 16 or not all(0 < len(name) <= LONGEST_NAME for name in (topic, kind)):
        return None
    reliability = said.number(RELIABILITY)
    quality = Quality(
        reliable=publishes if reliability is None else reliability == _RELIABLE,
        durability=said.number(DURABILITY) or 0,
        deadline=said.seconds(DEADLINE),
        liveliness=said.number(LIVELINESS) or 0,
        lease=said.seconds(LIVELINESS, at=4),
    )
    return Endpoint(guid=guid, topic=topic, type=kind, quality=quality)


def ros_type(dds: str) -> str:
    """Return ``std_msgs/msg/String`` for ``std_msgs::msg::dds_::String_``; a name without that form stays as it is."""
    return re.sub(r"^(\w+)::(\w+)::dds_::(\w+)_$", r"\1/\2/\3", dds)
