"""Which computers announce themselves in the local network? Multicast DNS (RFC 6762, RFC 6763).

The only module that imports zeroconf. Nothing leaves the local network. Avahi, which Raspberry Pi OS and Ubuntu's desktops
have, answers for ``HOSTNAME.local``; few systems announce their SSH server as a service.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zeroconf import (  # type: ignore[attr-defined]  # AddressResolver is public, and not in `__all__`
    AddressResolver,
    InterfaceChoice,
    IPVersion,
    ServiceBrowser,
    ServiceListener,
    Zeroconf,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

SERVICES = ("_ssh._tcp.local.", "_sftp-ssh._tcp.local.", "_workstation._tcp.local.")


@dataclass(frozen=True, kw_only=True)
class Announced:
    """A computer that announces itself: ``name`` is its host name, such as pi7.local."""

    name: str
    addresses: tuple[str, ...]


def addresses(name: str, *, seconds: float = 2.0, interfaces: Sequence[str] = ()) -> tuple[str, ...]:
    """Ask for the addresses of ``HOSTNAME.local``, IPv4 first. Without a network there are none."""
    with contextlib.suppress(OSError), _listening(interfaces) as network:
        resolver = AddressResolver(f"{name.rstrip('.')}.")
        resolver.request(network, seconds * 1000)
        return tuple(resolver.parsed_addresses())
    return ()


def browse(*, seconds: float = 3.0, interfaces: Sequence[str] = ()) -> tuple[Announced, ...]:
    """Listen for computers that announce an SSH server or themselves; ``interfaces`` are own addresses, default all."""
    found: dict[str, Announced] = {}
    with contextlib.suppress(OSError), _listening(interfaces) as network:
        names = _Names()
        with contextlib.closing(_Browser(network, names)):
            time.sleep(seconds)
        for kind, name in sorted(names.seen):
            info = network.get_service_info(kind, name, timeout=500)
            if info and info.server:
                host = info.server.rstrip(".")
                found[host.lower()] = Announced(name=host, addresses=tuple(info.parsed_addresses()))
    return tuple(found.values())


@contextlib.contextmanager
def _listening(interfaces: Sequence[str]) -> Iterator[Zeroconf]:
    network = Zeroconf(
        interfaces=list(interfaces) if interfaces else InterfaceChoice.All, ip_version=IPVersion.V4Only
    )
    try:
        yield network
    finally:
        network.close()


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
