"""Which computers does the desktop know in its own networks? Linux's table of neighbours, and the SSH servers among them."""

from __future__ import annotations

import contextlib
import ipaddress
import json
import socket
import subprocess
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

Place = tuple[str, int]
"""An address and a port."""

MAKERS = {
    **dict.fromkeys(("28:cd:c1", "2c:cf:67", "88:a2:9e", "b8:27:eb", "d8:3a:dd"), "Raspberry Pi"),
    **dict.fromkeys(("dc:a6:32", "e4:5f:01"), "Raspberry Pi"),
    **dict.fromkeys(("00:04:4b", "3c:6d:66", "48:b0:2d"), "NVIDIA Jetson"),
}
"""The first half of a network card's address, by the register of the IEEE."""

_LARGEST = 256
_AT_ONCE = 64
_GREETING = 1.5
"""Seconds for an SSH server to send its first line; a computer that is off answers nothing."""


def known() -> dict[str, str]:
    """Return the neighbours that answered lately: address -> the address of the network card."""
    rows = _ip("-4", "neigh", "show")
    return {
        row["dst"]: row["lladdr"]
        for row in rows
        if "lladdr" in row and not {"FAILED", "INCOMPLETE", "NONE"} & set(row.get("state", ()))
    }


def networks() -> tuple[ipaddress.IPv4Network, ...]:
    """Return the networks that the desktop is in, but for its own (loopback, Docker's) and those of more than 256 addresses."""
    found = [
        ipaddress.ip_network(f"{one['local']}/{one['prefixlen']}", strict=False)
        for link in _ip("-4", "addr", "show", "up")
        if link.get("link_type") == "ether" and not _own(link.get("ifname", ""))
        for one in link.get("addr_info", ())
    ]
    return tuple(
        net for net in found if isinstance(net, ipaddress.IPv4Network) and net.num_addresses <= _LARGEST
    )


def swept() -> tuple[str, ...]:
    """Return every address of these networks."""
    return tuple(str(host) for net in networks() for host in net.hosts())


def greetings(places: Iterable[Place]) -> dict[Place, str]:
    """Return the first line of each SSH server at these places, such as ``SSH-2.0-OpenSSH_10.0p2 Debian-7``."""
    wanted: Sequence[Place] = tuple(dict.fromkeys(places))
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        lines = pool.map(_greeting, wanted)
        return {place: line for place, line in zip(wanted, lines, strict=True) if line}


def maker(card: str) -> str:
    """Return who made a network card, by its address: Raspberry Pi, NVIDIA, or ""."""
    return MAKERS.get(card.lower()[:8], "")


def _own(interface: str) -> bool:
    return interface.startswith(("docker", "br-", "veth", "virbr", "lxc"))


def _greeting(place: Place) -> str:
    with contextlib.suppress(OSError), socket.create_connection(place, timeout=_GREETING) as stream:
        stream.settimeout(_GREETING)
        line = stream.recv(255).decode(errors="replace").splitlines()
        return line[0] if line and line[0].startswith("SSH-") else ""
    return ""


def _ip(*arguments: str) -> list[dict[str, Any]]:
    """What iproute2 tells; a desktop without it knows nobody."""
    with contextlib.suppress(OSError, subprocess.SubprocessError, ValueError):
        done = subprocess.run(
            ("ip", "-json", *arguments), stdin=subprocess.DEVNULL, capture_output=True, check=True, timeout=10
        )
        return list(json.loads(done.stdout or b"[]"))
    return []


def resolved(host: str) -> tuple[str, ...]:
    """Return the addresses that the desktop finds for a name, IPv4 first; none if it is not found."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return ()
    ordered = sorted(found, key=lambda one: one[0] != socket.AF_INET)
    return tuple(dict.fromkeys(str(address[0]) for *_, address in ordered))
