"""Which computers of the local network are robots of the inventory? Their host keys tell, whatever their addresses are."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fleet.errors import FleetError
from fleet.ssh import connect, known_hosts, mdns, neighbours, openssh_config

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from fleet.config.inventory import Robot
    from fleet.ssh.known_hosts import HostKey

_AT_ONCE = 16
_SYSTEMS = {"Raspbian": "Raspberry Pi OS", "Ubuntu": "Ubuntu", "Debian": "Debian"}
_LIKELY = ("Raspberry Pi", "NVIDIA Jetson")


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A computer that may be a robot: its address, and what can be known without a login."""

    address: str
    name: str = ""
    maker: str = ""
    greeting: str = ""

    @property
    def system(self) -> str:
        """The distribution that the SSH server's first line names, or ""."""
        return next((text for word, text in _SYSTEMS.items() if word in self.greeting), "")

    @property
    def likely(self) -> bool:
        """Whether it is one of the usual computers of robots."""
        return self.maker in _LIKELY or self.system == "Raspberry Pi OS"


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """A computer with its host key, and the robot of the inventory that it is.

    ``robot`` is empty for others; ``expected`` is the robot's address in the inventory. ``key`` is "known" if the host key
    is recorded for that robot, "changed" if another one is, and "new" if none is.
    """

    candidate: Candidate
    fingerprint: str
    key: str
    robot: str = ""
    expected: str = ""
    here: bool = False

    @property
    def moved(self) -> bool:
        """It is a robot of the inventory, by its host key, and not at the address that the inventory has."""
        return bool(self.robot) and not self.here and self.key == "known"


@dataclass(frozen=True, kw_only=True)
class Register:
    """What the inventory knows about its robots: their addresses in numbers, and their recorded host keys."""

    addresses: Mapping[str, str] = field(default_factory=dict)
    keys: Mapping[bytes, str] = field(default_factory=dict)
    expected: Mapping[str, str] = field(default_factory=dict)

    def sighting(self, candidate: Candidate, key: HostKey) -> Sighting:
        """Say which robot a computer with this host key is."""
        by_key, by_address = self.keys.get(key.blob, ""), self.addresses.get(candidate.address, "")
        robot = by_key or by_address
        state = "known" if by_key else "changed" if by_address in self.keys.values() else "new"
        return Sighting(
            candidate=candidate,
            fingerprint=key.fingerprint,
            key=state,
            robot=robot,
            expected=self.expected.get(robot, ""),
            here=bool(robot) and by_address == robot,
        )


def register(robots: Iterable[Robot]) -> Register:
    """Read the host keys that are recorded for robots, and look their addresses up."""
    addresses: dict[str, str] = {}
    keys: dict[bytes, str] = {}
    expected: dict[str, str] = {}
    for robot in robots:
        destination = openssh_config.resolve(robot)
        known = known_hosts.read((robot.known_hosts, *destination.known_hosts))
        for entry in known.entries(destination.known_as):
            if not entry.revoked:
                keys[entry.key.blob] = robot.name
        for address in neighbours.resolved(destination.host):
            addresses.setdefault(address, robot.name)
        expected[robot.name] = robot.address
    return Register(addresses=addresses, keys=keys, expected=expected)


def candidates(
    *, also: Iterable[str] = (), scan: bool = False, seconds: float = 3.0
) -> tuple[Candidate, ...]:
    """Look around: who announces itself, who is a neighbour, and with ``scan`` every address of the desktop's networks."""
    announced = mdns.browse(seconds=seconds)
    names = {address: one.name for one in announced for address in one.addresses if ":" not in address}
    cards = neighbours.known()
    greetings = neighbours.greetings((*names, *also, *cards, *(neighbours.swept() if scan else ())))
    cards = {**cards, **(neighbours.known() if scan else {})}
    return tuple(
        Candidate(
            address=address,
            name=names.get(address, ""),
            maker=neighbours.maker(cards.get(address, "")),
            greeting=greeting,
        )
        for address, greeting in greetings.items()
    )


def sight(found: Sequence[Candidate], *, like: Robot, register: Register) -> tuple[Sighting, ...]:
    """Ask each computer for its host key, without a login. Those that do not answer are left out."""

    def ask(candidate: Candidate) -> Sighting | None:
        robot = like.model_copy(update={"address": candidate.address, "port": None})
        try:
            return register.sighting(candidate, connect.offered_key(robot, connect_timeout=5)[1])
        except FleetError:
            return None

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        return tuple(one for one in pool.map(ask, found) if one)
