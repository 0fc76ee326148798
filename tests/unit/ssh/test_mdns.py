from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import pytest
from zeroconf import IPVersion, ServiceInfo, Zeroconf

from fleet.ssh import mdns
from fleet.ssh.mdns import Announced

if TYPE_CHECKING:
    from collections.abc import Iterator

LOOPBACK = ("127.0.0.1",)
ADDRESS = "192.0.2.7"


@pytest.fixture
def robot() -> Iterator[None]:
    """A computer that announces itself, on the loopback interface only."""
    responder = Zeroconf(interfaces=list(LOOPBACK), ip_version=IPVersion.V4Only)
    service = ServiceInfo(
        "_ssh._tcp.local.",
        "fleet-test-pi7._ssh._tcp.local.",
        port=22,
        server="fleet-test-pi7.local.",
        addresses=[socket.inet_aton(ADDRESS)],
    )
    responder.register_service(service)
    yield
    responder.close()


@pytest.mark.usefixtures("robot")
def test_a_name_has_addresses() -> None:
    """One that nobody has has none, after the time."""
    assert mdns.addresses("fleet-test-pi7.local", interfaces=LOOPBACK) == (ADDRESS,)
    assert mdns.addresses("fleet-test-nobody.local", seconds=0.5, interfaces=LOOPBACK) == ()


@pytest.mark.usefixtures("robot")
def test_who_is_there() -> None:
    assert Announced(name="fleet-test-pi7.local", addresses=(ADDRESS,)) in mdns.browse(
        seconds=1.0, interfaces=LOOPBACK
    )


def test_without_a_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """A desktop without one hears nobody."""

    def refused(**_: object) -> None:
        raise OSError(19, "No such device")

    monkeypatch.setattr(mdns, "Zeroconf", refused)
    assert mdns.addresses("pi7.local", seconds=0.1) == ()
    assert mdns.browse(seconds=0.1) == ()
