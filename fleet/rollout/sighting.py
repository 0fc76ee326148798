"""Which computers of the local network are robots of the inventory? Their host keys tell, whatever their addresses are.

A computer may have several addresses (a cable and Wi-Fi, IPv4 and IPv6), and a copied card gives its host key to two
computers. A host key alone does not tell one from the other; the names that they announce do.
"""

from __future__ import annotations

import ipaddress
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from fleet.errors import DesktopError, FleetError
from fleet.ssh import connect, known_hosts, neighbours, openssh_config

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from fleet.config.inventory import Robot
    from fleet.ssh.known_hosts import HostKey
    from fleet.ssh.mdns import Announced
    from fleet.ssh.neighbours import Place

_AT_ONCE = 16
_SYSTEMS = {"Raspbian": "Raspberry Pi OS", "Ubuntu": "Ubuntu", "Debian": "Debian"}
_LIKELY = ("Raspberry Pi", "NVIDIA Jetson")


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A computer that may be a robot: one of its addresses, and what can be known without a login."""

    address: str
    port: int = 22
    name: str = ""
    maker: str = ""
    greeting: str = ""

    @property
    def where(self) -> str:
        """Its address, with the port if that is not the usual one."""
        return known_hosts.host_name(self.address, self.port)

    @property
    def order(self) -> tuple[int, int, int]:
        """Its place in a list by addresses: by their numbers, IPv4 first."""
        parsed = ipaddress.ip_address(self.address)
        return parsed.version, int(parsed), self.port

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
    is recorded for that robot, "changed" if another one is, and "new" if none is; "copied" if another computer has the same
    one, and this one is not where the inventory has a robot. ``also`` are further addresses of the computer.
    """

    candidate: Candidate
    fingerprint: str
    key: str
    robot: str = ""
    expected: str = ""
    here: bool = False
    also: tuple[Candidate, ...] = ()

    @property
    def moved(self) -> bool:
        """It is a robot of the inventory, by its host key, and not at the address that the inventory has."""
        return bool(self.robot) and not self.here and self.key == "known"


@dataclass(frozen=True, kw_only=True)
class Register:
    """What the inventory knows about its robots: their places in numbers, their ports, and their recorded host keys.

    A host key may be that of several robots: of a copied card, or of one computer with two names in the inventory.
    """

    places: Mapping[Place, str] = field(default_factory=dict)
    ports: frozenset[int] = frozenset()
    keys: Mapping[bytes, tuple[str, ...]] = field(default_factory=dict)
    expected: Mapping[str, str] = field(default_factory=dict)

    def sighting(self, candidate: Candidate, key: HostKey) -> Sighting:
        """Say which robot a computer with this host key is."""
        by_key = self.keys.get(key.blob, ())
        by_address = self.places.get((candidate.address, candidate.port), "")
        robot = by_address if by_address in by_key or not by_key else by_key[0]
        trusted = {name for names in self.keys.values() for name in names}
        state = "known" if by_key else "changed" if by_address in trusted else "new"
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
    places: dict[Place, str] = {}
    ports: set[int] = set()
    keys: dict[bytes, tuple[str, ...]] = {}
    expected: dict[str, str] = {}
    for robot in robots:
        destination = openssh_config.resolve(robot)
        known = known_hosts.read((robot.known_hosts, *destination.known_hosts))
        for entry in known.entries(destination.known_as):
            if not entry.revoked:
                names = keys.get(entry.key.blob, ())
                keys[entry.key.blob] = tuple(dict.fromkeys((*names, robot.name)))
        for address in neighbours.resolved(destination.host):
            places.setdefault((address, destination.port), robot.name)
        ports.add(destination.port)
        expected[robot.name] = robot.address
    return Register(places=places, ports=frozenset(ports), keys=keys, expected=expected)


def candidates(
    *,
    also: Iterable[Place] = (),
    ports: Iterable[int] = (),
    scan: bool = False,
    seconds: float = 3.0,
    on_problem: Callable[[DesktopError], None] = lambda _: None,
) -> tuple[Candidate, ...]:
    """Look around: who announces itself, who is a neighbour, and with ``scan`` every address of the desktop's networks.

    ``also`` are further places to look at. Neighbours are asked at port 22 and at ``ports``. ``on_problem`` gets the reason
    if nobody can be asked who announces itself; the others are looked at nevertheless.
    """
    from fleet.ssh import mdns  # noqa: PLC0415  zeroconf is a tenth of all imports, and most verbs do without

    announced: tuple[Announced, ...] = ()
    try:
        announced = mdns.browse(seconds=seconds)
    except DesktopError as problem:
        on_problem(problem)
    names = {(address, one.port): one.name for one in announced for address in _reachable(one.addresses)}
    cards = neighbours.known()
    around = (*cards, *(neighbours.swept() if scan else ()))
    everywhere = ((address, port) for port in sorted({22, *ports}) for address in around)
    greetings = neighbours.greetings((*names, *also, *everywhere))
    cards = {**cards, **(neighbours.known() if scan else {})}
    by_address = {address: name for (address, _), name in names.items()}
    return tuple(
        Candidate(
            address=address,
            port=port,
            name=by_address.get(address, ""),
            maker=neighbours.maker(cards.get(address, "")),
            greeting=greeting,
        )
        for (address, port), greeting in greetings.items()
    )


def _reachable(addresses: Sequence[str]) -> Sequence[str]:
    """The IPv4 addresses of a computer; if it has none, those of IPv6 that need no name of a network card."""
    parsed = [ipaddress.ip_address(address) for address in addresses]
    four = [str(one) for one in parsed if one.version == 4]
    return four or [str(one) for one in parsed if not one.is_link_local]


def sight(found: Sequence[Candidate], *, like: Robot, register: Register) -> tuple[Sighting, ...]:
    """Ask each computer for its host key, without a login. Those that do not answer are left out."""

    def ask(candidate: Candidate) -> Sighting | None:
        robot = like.model_copy(update={"address": candidate.address, "port": candidate.port})
        try:
            return register.sighting(candidate, connect.offered_key(robot, connect_timeout=5)[1])
        except FleetError:
            return None

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        return tuple(one for one in pool.map(ask, found) if one)


def computers(seen: Iterable[Sighting]) -> tuple[Sighting, ...]:
    """Return each computer once, with its further addresses.

    Addresses with the same host key are one computer, unless they announce different names, or are where the inventory has
    different robots.
    """
    by_key: dict[str, list[list[Sighting]]] = {}
    for one in sorted(seen, key=lambda one: (not one.here, not one.candidate.name)):  # the surest first
        there = by_key.setdefault(one.fingerprint, [])
        same = next((group for group in there if _may_be(one, group)), None)
        if same is None:
            there.append([one])
        else:
            same.append(one)
    return tuple(_computer(group, copied=len(groups) > 1) for groups in by_key.values() for group in groups)


def _may_be(one: Sighting, group: Sequence[Sighting]) -> bool:
    names = {other.candidate.name for other in group} - {""}
    robots = {other.robot for other in group if other.here}
    return (not one.candidate.name or not names or one.candidate.name in names) and (
        not one.here or not robots or one.robot in robots
    )


def _computer(group: Sequence[Sighting], *, copied: bool) -> Sighting:
    first = group[0]
    name = next((one.candidate.name for one in group if one.candidate.name), "")
    maker = next((one.candidate.maker for one in group if one.candidate.maker), "")
    one = replace(
        first,
        candidate=replace(first.candidate, name=name, maker=maker),
        also=tuple(other.candidate for other in group[1:]),
    )
    return replace(one, key="copied", robot="", expected="") if copied and not one.here else one
