from __future__ import annotations

import ipaddress
import json
import socket
import stat
from typing import TYPE_CHECKING

import pytest

from fleet.ssh import neighbours
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.sshd import Sshd

NEIGHBOURS = [
    {"dst": "192.168.1.7", "dev": "eth0", "lladdr": "2c:cf:67:00:00:01", "state": ["REACHABLE"]},
    {"dst": "192.168.1.8", "dev": "eth0", "state": ["INCOMPLETE"]},
    {"dst": "192.168.1.9", "dev": "eth0", "lladdr": "48:b0:2d:00:00:01", "state": ["FAILED"]},
]
LINKS = [
    {"ifname": "lo", "link_type": "loopback", "addr_info": [{"local": "127.0.0.1", "prefixlen": 8}]},
    {"ifname": "eth0", "link_type": "ether", "addr_info": [{"local": "192.168.1.2", "prefixlen": 29}]},
    {"ifname": "eth1", "link_type": "ether", "addr_info": [{"local": "10.0.0.2", "prefixlen": 16}]},
    {"ifname": "docker0", "link_type": "ether", "addr_info": [{"local": "172.17.0.1", "prefixlen": 24}]},
    {"ifname": "wlan0", "link_type": "ether"},
]


@pytest.fixture
def iproute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A desktop with these neighbours and networks."""
    (tmp_path / "neigh").write_text(json.dumps(NEIGHBOURS))
    (tmp_path / "addr").write_text(json.dumps(LINKS))
    program = tmp_path / "ip"
    program.write_text(f'#!/bin/sh\ncat "{tmp_path}/$3"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")


@pytest.mark.usefixtures("iproute", "desktop")
def test_who_answered_lately_and_where_to_look() -> None:
    """Large networks, the desktop's own and Docker's are not swept."""
    assert neighbours.known() == {"192.168.1.7": "2c:cf:67:00:00:01"}
    assert neighbours.networks() == (ipaddress.IPv4Network("192.168.1.0/29"),)
    assert neighbours.swept() == tuple(f"192.168.1.{number}" for number in range(1, 7))


@pytest.mark.usefixtures("desktop")
def test_a_desktop_without_iproute(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert neighbours.known() == {}
    assert neighbours.networks() == ()


def test_the_makers_of_network_cards() -> None:
    assert neighbours.maker("2C:CF:67:12:34:56") == "Raspberry Pi"
    assert neighbours.maker("48:b0:2d:12:34:56") == "NVIDIA Jetson"
    assert neighbours.maker("02:42:ac:1b:00:0b") == neighbours.maker("") == ""


def test_who_speaks_ssh(sshd: Sshd) -> None:
    """Others, and nobody, are left out."""
    place = ("127.0.0.1", sshd.port)
    found = neighbours.greetings((place, place, ("127.0.0.1", free_port())))
    assert found.keys() == {place}
    assert found[place].startswith("SSH-2.0-OpenSSH")


def test_the_addresses_of_a_name() -> None:
    assert neighbours.resolved("127.0.0.1") == ("127.0.0.1",)
    assert neighbours.resolved("::1") == ("::1",)
    assert neighbours.resolved("fleet-test.invalid") == neighbours.resolved("a" * 64 + ".x") == ()


def test_ipv4_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is how people know their robots."""
    found = [
        (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("fd00::7", 0, 0, 0)),
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("10.0.0.7", 0)),
    ]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    assert neighbours.resolved("pi7.local") == ("10.0.0.7", "fd00::7")
