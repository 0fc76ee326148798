"""What becomes of packets between a desk and robots: how long do they take, and which never arrive?

The process behind `wifi.joined`. It gets open TUN devices, and a socket on which it is told what to change and asked what
it counted; it ends when that socket closes, and the devices with it.
"""

from __future__ import annotations

import heapq
import json
import os
import random
import select
import socket
import sys
import time
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

DELAY_HOLDS = 0.1
"""Seconds until a link's delay changes. One drawn for every packet would always be near the longest, as order is kept."""

AT_ONCE = 64  # packets taken from one device before the others get their turn
LARGEST = 65536


@dataclass(slots=True, kw_only=True)
class Counted:
    """Packets and bytes of one direction. ``sent`` went on the air, ``lost`` are those of them that nobody heard.

    ``dropped`` found the queue full, and ``cut`` met an outage: neither took time on the air.
    """

    sent: int = 0
    sent_bytes: int = 0
    lost: int = 0
    lost_bytes: int = 0
    dropped: int = 0
    dropped_bytes: int = 0
    cut: int = 0
    cut_bytes: int = 0


@dataclass(slots=True, kw_only=True)
class Way:
    """One direction of a link: the device it ends at, when it is free again, and when its last packet arrives."""

    end: int
    free: float = 0.0
    last: float = 0.0
    counted: Counted = field(default_factory=Counted)


@dataclass(slots=True, kw_only=True)
class Link:
    """One robot's link. Bytes and seconds here; ``delays`` are those of one direction."""

    to: Way
    back: Way
    rate: float = 0.0
    delays: tuple[float, float] = (0.0, 0.0)
    loss: float = 0.0
    queue: float = 0.0
    whole: float = 0.0
    delay: float = 0.0
    delay_until: float = 0.0

    def change(self, settings: Mapping[str, Any], now: float) -> None:
        """Take new values, as `wifi.Quality` has them, or ``outage``: seconds of nothing."""
        for name, value in settings.items():
            match name:
                case "rate":
                    self.rate = value * 1e6 / 8
                case "round_trip":
                    self.delays, self.delay_until = (value[0] / 2000, value[1] / 2000), 0.0
                case "queue":
                    self.queue = value / 1000
                case "loss":
                    self.loss = value
                case "outage":
                    self.whole = now + value
                case _:
                    raise ValueError(name)


class Air:
    """All links, and what is on its way. ``rate`` is what they share, in bytes a second; 0 for each its own."""

    def __init__(self, links: Mapping[str, Link], *, desk: int, rate: float, seed: int) -> None:
        self.links = links
        self._desk, self._rate, self._free = desk, rate, 0.0
        self._chance = random.Random(seed)  # noqa: S311  repeatable is what it has to be
        self._flying: list[tuple[float, int, bytes, Link, Way]] = []
        self._number = 0
        self._by_device = {link.to.end: link for link in links.values()}
        self._by_address: dict[bytes, Link] = {}

    def named(self, addresses: Mapping[str, str]) -> None:
        """Which robot a packet from the desk is for."""
        self._by_address = {socket.inet_aton(addresses[name]): link for name, link in self.links.items()}

    def take(self, device: int, packet: bytes, now: float) -> None:
        """A packet that was written to a device, at the desk or on a robot."""
        if packet[0] >> 4 != 4:
            return
        if device != self._desk:
            link = self._by_device[device]
            self._carry(link, link.back, packet, now)
        elif link_to := self._by_address.get(packet[16:20]):
            self._carry(link_to, link_to.to, packet, now)

    def _carry(self, link: Link, way: Way, packet: bytes, now: float) -> None:
        size, counted = len(packet), way.counted
        if now < link.whole:
            counted.cut += 1
            counted.cut_bytes += size
            return
        starts = max(now, way.free, self._free if self._rate else 0.0)
        if starts - now > link.queue:
            counted.dropped += 1
            counted.dropped_bytes += size
            return
        way.free = starts + size / link.rate
        if self._rate:
            self._free = starts + size / min(self._rate, link.rate)
        counted.sent += 1
        counted.sent_bytes += size
        if self._chance.random() < link.loss:
            counted.lost += 1
            counted.lost_bytes += size
            return
        if now >= link.delay_until:
            link.delay, link.delay_until = self._chance.uniform(*link.delays), now + DELAY_HOLDS
        # Wi-Fi hardly ever changes the order.
        way.last = max(way.last, way.free + link.delay)
        self._number += 1
        heapq.heappush(self._flying, (way.last, self._number, packet, link, way))

    def deliver(self, now: float) -> float:
        """Hand over what has arrived by now; the seconds until there is more, -1 where nothing is on its way."""
        while self._flying and self._flying[0][0] <= now:
            _, _, packet, link, way = heapq.heappop(self._flying)
            if now < link.whole:
                way.counted.cut += 1
                way.counted.cut_bytes += len(packet)
                continue
            try:
                os.write(way.end, packet)
            except OSError:  # the device is down, or gone with its robot
                way.counted.dropped += 1
                way.counted.dropped_bytes += len(packet)
        return self._flying[0][0] - now if self._flying else -1


def answer(air: Air, asked: Mapping[str, Any]) -> object:
    """Do what the socket says: change a link, or say what was counted."""
    now = time.monotonic()
    for name in asked.get("robots", ()):
        air.links[name].change(asked["change"], now)
    return {
        name: {"to": asdict(link.to.counted), "back": asdict(link.back.counted)}
        for name, link in air.links.items()
    }


def read(air: Air, device: int) -> bool:
    """Take what waits at a device; False where it is gone."""
    try:
        for _ in range(AT_ONCE):
            air.take(device, os.read(device, LARGEST), time.monotonic())
    except BlockingIOError:
        pass
    except OSError:
        return False
    return True


def main() -> None:
    """Carry packets until the socket closes. Its number is the argument; its first message has all the rest."""
    control = socket.socket(fileno=int(sys.argv[1]))
    given = json.loads(control.recv(LARGEST))
    links = {
        name: Link(to=Way(end=device), back=Way(end=given["desk"]))
        for name, device in given["devices"].items()
    }
    air = Air(links, desk=given["desk"], rate=given["air"] * 1e6 / 8, seed=given["seed"])
    air.named(given["addresses"])
    waiting = select.epoll()
    for device in (control.fileno(), given["desk"], *given["devices"].values()):
        waiting.register(device, select.EPOLLIN)
    control.send(json.dumps(answer(air, {"robots": list(links), "change": given["quality"]})).encode())
    while True:
        for device, _ in waiting.poll(air.deliver(time.monotonic())):
            if device != control.fileno():
                if not read(air, device):
                    waiting.unregister(device)
            elif asked := control.recv(LARGEST):
                control.send(json.dumps(answer(air, json.loads(asked))).encode())
            else:
                return


if __name__ == "__main__":
    main()
