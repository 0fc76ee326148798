"""Which computers announce themselves in the local network? Multicast DNS (RFC 6762, RFC 6763).

The only module that imports zeroconf. Nothing leaves the local network. Avahi, which Raspberry Pi OS and Ubuntu's desktops
have, answers for ``HOSTNAME.local``; few systems announce their SSH server as a service.
"""

from __future__ import annotations

import contextlib
import errno
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zeroconf import (  # type: ignore[attr-defined]  # AddressResolver is public, and not in `__all__`
    AddressResolver,
    Error,
    InterfaceChoice,
    IPVersion,
    ServiceBrowser,
    ServiceListener,
    Zeroconf,
)

from fleet.errors import DesktopError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_SSH = ("_ssh._tcp.local.", "_sftp-ssh._tcp.local.")
SERVICES = (*_SSH, "_workstation._tcp.local.")

_WHOSE = (
    "`sudo ss --udp --listening --processes 'sport = :5353'` shows the program that has the port for itself; avahi-daemon "
    "shares it with `disallow-other-stacks=no` in avahi-daemon.conf"
)
_NETWORK = "connect this computer to the robots' network"


@dataclass(frozen=True, kw_only=True)
class Announced:
    """A computer that announces itself: ``name`` is its host name, such as pi7.local; ``port`` that of its SSH server."""

    name: str
    addresses: tuple[str, ...]
    port: int = 22


def addresses(name: str, *, seconds: float = 2.0, interfaces: Sequence[str] = ()) -> tuple[str, ...]:
    """Ask for the addresses of ``HOSTNAME.local``, IPv4 first.

    Raises:
        DesktopError: nobody can be asked, because there is no network, or another program has the port for itself.

    """
    with _listening(interfaces) as network:
        resolver = AddressResolver(f"{name.rstrip('.')}.")
        resolver.request(network, seconds * 1000)
        return tuple(resolver.parsed_addresses())


def browse(*, seconds: float = 3.0, interfaces: Sequence[str] = ()) -> tuple[Announced, ...]:
    """Listen for computers that announce an SSH server or themselves; ``interfaces`` are own addresses, default all.

    Raises:
        DesktopError: as for `addresses`.

    """
    found: dict[tuple[str, int], Announced] = {}
    with _listening(interfaces) as network:
        names = _Names()
        with contextlib.closing(_Browser(network, names)):
            time.sleep(seconds)
        for kind, name in sorted(names.seen):
            info = network.get_service_info(kind, name, timeout=500)
            if info and info.server:
                host, port = info.server.rstrip("."), info.port or 22 if kind in _SSH else 22
                found[host.lower(), port] = Announced(
                    name=host, addresses=tuple(info.parsed_addresses()), port=port
                )
    return tuple(found.values())


@contextlib.contextmanager
def _listening(interfaces: Sequence[str]) -> Iterator[Zeroconf]:
    try:
        network = Zeroconf(
            interfaces=list(interfaces) if interfaces else InterfaceChoice.All, ip_version=IPVersion.V4Only
        )
        with contextlib.closing(network):
            yield network
    # zeroconf raises RuntimeError if no network card has an address, and its own errors without a text.
    except (OSError, Error, RuntimeError) as problem:
        reason = getattr(problem, "strerror", None) or str(problem) or type(problem).__name__
        taken = isinstance(problem, OSError) and problem.errno == errno.EADDRINUSE
        raise DesktopError(
            f"nobody can be asked by name (mDNS, UDP port 5353): {reason}", cure=_WHOSE if taken else _NETWORK
        ) from None


class _Names(ServiceListener):
    """Collects what is announced."""

    def __init__(self) -> None:
        self.seen: set[tuple[str, str]] = set()

    def add_service(self, zc: Zeroconf, type_: str, name: str) -> None:  # noqa: ARG002  zeroconf's own
        self.seen.add((type_, name))

    def update_service(self, zc: Zeroconf, type_: str, name: str) -> None:
        """See ``zeroconf.ServiceListener``."""

    def remove_service(self, zc: Zeroconf, type_: str, name: str) -> None:
        """See ``zeroconf.ServiceListener``. It was there a moment ago, which is enough."""


class _Browser(ServiceBrowser):
    """Zeroconf's own, for all services, with the usual name for its end."""

    def __init__(self, network: Zeroconf, names: _Names) -> None:
        super().__init__(network, list(SERVICES), listener=names)

    def close(self) -> None:
        """Listen no longer."""
        self.cancel()
