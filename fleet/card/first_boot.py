"""What does a robot need to know at its first boot? Values, whichever system reads them."""

from __future__ import annotations

import hashlib
import re
import string
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from fleet.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Collection

    from fleet.config.inventory import Robot

MARK = "# Written by `fab card` for the robot "
"""How a file begins, or the line after its first, that tells for whom the card is."""

HIDDEN = "(hidden)"
"""What stands in place of a secret that is shown."""

_LABEL = re.compile(r"[a-z0-9](?:[a-z0-9-]{0,61}[a-z0-9])?", re.IGNORECASE)
_PRINTABLE = frozenset(string.printable) - frozenset("\t\n\r\x0b\x0c")


@dataclass(frozen=True, kw_only=True)
class HostKey:
    """An SSH host key of type ed25519: the private key in OpenSSH's format, and the line of the public one."""

    private: str = field(repr=False)
    public: str


@dataclass(frozen=True, kw_only=True)
class Network:
    """A Wi-Fi network. ``key`` is its key in hexadecimal digits, empty if it is open."""

    name: str
    key: str = field(repr=False)
    hidden: bool = False


@dataclass(frozen=True, kw_only=True)
class FirstBoot:
    """What the first boot of a robot sets.

    ``keys`` are lines of ``authorized_keys``. ``country`` is empty without Wi-Fi, ``timezone`` if the system keeps its
    own. ``announces``: the robot is reached by the name that it announces by mDNS. ``password`` is a hash, for systems
    that take no key.
    """

    robot: str
    hostname: str
    user: str
    keys: tuple[str, ...]
    host_key: HostKey | None = None
    timezone: str = ""
    country: str = ""
    networks: tuple[Network, ...] = ()
    announces: bool = False
    password: str = field(default="", repr=False)

    def without_secrets(self) -> FirstBoot:
        """The same to be shown to people."""
        networks = tuple(replace(one, key=HIDDEN if one.key else "") for one in self.networks)
        host_key = replace(self.host_key, private=HIDDEN) if self.host_key else None
        return replace(self, networks=networks, host_key=host_key, password=HIDDEN if self.password else "")


def hostname(robot: Robot) -> str:
    """Return the host name of a robot: its address is ``HOSTNAME.local``, or it has the robot's name.

    Raises:
        UsageError: a computer cannot have this name.

    """
    name = robot.address.removesuffix(".local") if robot.address.endswith(".local") else robot.name
    if not _LABEL.fullmatch(name):
        raise UsageError(
            f"{robot.name}: a computer cannot be called {name}",
            cure="rename the robot, or give it an address such as pi7.local: letters, digits and '-', at most 63",
        )
    return name


def prepared_for(text: str) -> str:
    """Return the robot that a file was written for, "" if `fab card` did not write it."""
    lines = (line.removeprefix(MARK) for line in text.splitlines()[:3] if line.startswith(MARK))
    return next(lines, "").strip()


def check_timezone(name: str, *, known: Collection[str]) -> None:
    """Refuse a time zone that is not one of ``known``; without any, the desktop cannot tell."""
    if name and known and name not in known:
        cure = "`timedatectl list-timezones` shows all of them"
        raise UsageError(f"there is no time zone {name} (card.timezone)", cure=cure)


def wifi_key(passphrase: str, *, network: str) -> str:
    """Return the key of a network that its passphrase stands for, as 64 hexadecimal digits (IEEE 802.11i, H.4).

    Raises:
        UsageError: it cannot be the passphrase of a Wi-Fi network.

    """
    if re.fullmatch(r"[0-9A-Fa-f]{64}", passphrase):
        return passphrase.lower()
    if not 8 <= len(passphrase) <= 63:
        raise UsageError(
            f"the passphrase of the Wi-Fi {network} has {len(passphrase)} characters",
            cure="Wi-Fi takes 8 to 63 of them; for a network without a passphrase say `open: true`",
        )
    if not _PRINTABLE.issuperset(passphrase):
        raise UsageError(
            f"the passphrase of the Wi-Fi {network} has a character that Wi-Fi does not take",
            cure="Wi-Fi takes letters without accents, digits and punctuation",
        )
    # Written instead of the passphrase, which people use elsewhere too.
    return hashlib.pbkdf2_hmac("sha1", passphrase.encode(), network.encode(), 4096, 32).hex()
