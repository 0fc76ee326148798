from __future__ import annotations

import pytest

from fleet.errors import NotAsPlanned
from fleet.robot.claims import Claim, Port, parse


def test_names_projects_and_ports_are_read() -> None:
    """Ports that are not published are nobody's; one on IPv4 and IPv6 is one."""
    text = (
        "cam-1|cam|0.0.0.0:8080->80/tcp, :::8080->80/tcp, 9000/tcp\n"
        "web||127.0.0.1:53->53/udp, [::]:6000-6001->6000-6001/tcp\n"
        "idle|tiny|\nnonsense\n|x|\n"
    )
    assert parse(text) == (
        Claim(name="cam-1", project="cam", ports=(Port(number=8080),)),
        Claim(
            name="web",
            ports=(
                Port(number=53, protocol="udp", address="127.0.0.1"),
                Port(number=6000),
                Port(number=6001),
            ),
        ),
        Claim(name="idle", project="tiny"),
    )


def test_a_huge_range_is_bounded() -> None:
    """A robot's answer is a stranger's."""
    assert len(parse("x||0.0.0.0:1-99999->1-99999/tcp")[0].ports) == 65535


@pytest.mark.parametrize("between", [", ", "\ny||"])
def test_more_ports_than_a_computer_has_are_refused(between: str) -> None:
    """In one line or in many, each with all ports of another address."""
    lines = between.join(f"10.0.{number}.1:1-65535->1-65535/tcp" for number in range(5))
    with pytest.raises(NotAsPlanned, match="more published ports than a computer has"):
        parse(f"x||{lines}")


@pytest.mark.parametrize(
    ("other", "clash"),
    [
        (Port(number=80), True),
        (Port(number=80, address="10.0.0.1"), True),
        (Port(number=80, protocol="udp"), False),
        (Port(number=81), False),
    ],
)
def test_which_ports_clash(other: Port, clash: bool) -> None:
    """One for all addresses clashes with one for any of them."""
    assert Port(number=80).clashes(other) is clash
    assert other.clashes(Port(number=80)) is clash


def test_two_addresses_may_have_one_port_each() -> None:
    """As with a robot on two networks."""
    assert not Port(number=80, address="10.0.0.1").clashes(Port(number=80, address="10.0.0.2"))
