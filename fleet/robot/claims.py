"""Which names and ports do the containers on a robot hold, whoever started them?"""

from __future__ import annotations

import re
from dataclasses import dataclass

from fleet.errors import NotAsPlanned

_PORTS = re.compile(
    r"(?:(?P<ip>[0-9a-fA-F.:]+|\[[^\]]+\]):)?(?P<first>[0-9]{1,5})(?:-(?P<last>[0-9]{1,5}))?->[0-9-]+/(?P<protocol>\w+)"
)

ANY = ("0.0.0.0", "::", "[::]", "")  # noqa: S104  read, not bound
"""Addresses that mean all of a computer's addresses."""


MOST_PORTS = 4 * 65_536
"""Ports of all containers: TCP and UDP, IPv4 and IPv6. A robot could name as many in each line."""


@dataclass(frozen=True, kw_only=True)
class Port:
    """A port of the robot that is published for a container; ``address`` is "" for all addresses."""

    number: int
    protocol: str = "tcp"
    address: str = ""

    def clashes(self, other: Port) -> bool:
        """Whether both cannot be had at once."""
        same = (self.number, self.protocol) == (other.number, other.protocol)
        return same and (not self.address or not other.address or self.address == other.address)


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One container: its name, its Compose project ("" if it has none), and the ports it has while it runs."""

    name: str
    project: str = ""
    ports: tuple[Port, ...] = ()


def parse(lines: str) -> tuple[Claim, ...]:
    """Read lines of ``docker ps``: ``NAME|PROJECT|PORTS``; others are skipped.

    Raises:
        NotAsPlanned: they have more ports than `MOST_PORTS`.

    """
    rows = (line.split("|") for line in lines.splitlines())
    found: list[Claim] = []
    left = MOST_PORTS
    for row in rows:
        if len(row) == 3 and row[0]:
            found.append(Claim(name=row[0], project=row[1], ports=_ports(row[2], most=left)))
            left -= len(found[-1].ports)
    return tuple(found)


def _ports(text: str, *, most: int) -> tuple[Port, ...]:
    """``0.0.0.0:8080-8082->80-82/tcp, :::8080-8082->80-82/tcp``: those that are published."""
    ports: dict[Port, None] = {}
    for found in _PORTS.finditer(text):
        first, last = int(found["first"]), min(int(found["last"] or found["first"]), 65535)
        if len(ports) + last - first >= most:
            raise NotAsPlanned(
                "the robot's answer has more published ports than a computer has",
                cure="log in and see what its `docker ps` prints",
            )
        address = "" if (found["ip"] or "") in ANY else found["ip"]
        for number in range(first, last + 1):
            port = Port(number=number, protocol=found["protocol"], address=address)
            ports[port] = None
    return tuple(ports)
