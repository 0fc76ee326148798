from __future__ import annotations

import errno
import secrets
import socket
from typing import TYPE_CHECKING

import pytest
from zeroconf import Error, IPVersion, NotRunningException, ServiceInfo, Zeroconf

from fleet.errors import DesktopError
from fleet.ssh import mdns
from fleet.ssh.mdns import Announced

if TYPE_CHECKING:
    from collections.abc import Iterator

LOOPBACK = ("127.0.0.1",)
ADDRESS = "192.0.2.7"


@pytest.fixture
def robot() -> Iterator[str]:
    """A computer that announces itself, on the loopback interface only, by a name that no other test run has."""
    name = f"fleet-test-{secrets.token_hex(8)}"
    responder = Zeroconf(interfaces=list(LOOPBACK), ip_version=IPVersion.V4Only)
    service = ServiceInfo(
        "_ssh._tcp.local.",
        f"{name}._ssh._tcp.local.",
        port=2222,
        server=f"{name}.local.",
        addresses=[socket.inet_aton(ADDRESS)],
    )
    responder.register_service(service)
    yield f"{name}.local"
    responder.close()


def test_a_name_has_addresses(robot: str) -> None:
    """One that nobody has has none, after the time."""
    assert mdns.addresses(robot, interfaces=LOOPBACK) == (ADDRESS,)
    assert mdns.addresses(f"not-{robot}", seconds=0.5, interfaces=LOOPBACK) == ()


def test_who_is_there(robot: str) -> None:
    """With the port of its SSH server."""
    found = mdns.browse(seconds=1.0, interfaces=LOOPBACK)
    assert Announced(name=robot, addresses=(ADDRESS,), port=2222) in found


@pytest.mark.parametrize(
    ("problem", "reason", "cure"),
    [
        (OSError(errno.ENODEV, "No such device"), "No such device", "connect this computer"),
        (OSError(errno.EADDRINUSE, "Address already in use"), "Address already in use", "sudo ss --udp"),
        (RuntimeError("No interfaces to listen on"), "No interfaces to listen on", "connect this computer"),
        (NotRunningException(), "NotRunningException", "connect this computer"),
        (Error("strange"), "strange", "connect this computer"),
    ],
    ids=["no network", "taken", "no address", "not running", "other"],
)
def test_nobody_can_be_asked(
    monkeypatch: pytest.MonkeyPatch, problem: Exception, reason: str, cure: str
) -> None:
    """One sentence, whatever zeroconf raises."""

    def refused(**_: object) -> None:
        raise problem

    monkeypatch.setattr(mdns, "Zeroconf", refused)
    for ask in (lambda: mdns.addresses("pi7.local", seconds=0.1), lambda: mdns.browse(seconds=0.1)):
        with pytest.raises(DesktopError) as told:
            ask()
        assert told.value.what == f"nobody can be asked by name (mDNS, UDP port 5353): {reason}"
        assert cure in told.value.cure


def test_a_network_that_goes_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    """zeroconf's own errors come while it is asked, too."""

    class Gone:
        def __init__(self, _: str) -> None: ...

        def request(self, *_: object) -> None:
            raise NotRunningException

    monkeypatch.setattr(mdns, "AddressResolver", Gone)
    with pytest.raises(DesktopError, match="nobody can be asked by name"):
        mdns.addresses("pi7.local", seconds=0.1, interfaces=LOOPBACK)
