from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.cli import push
from fleet.config.registry import Registry
from fleet.errors import UsageError
from tests.support.samples import PI

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.config.inventory import Robot


def robot(address: str, ca: Path | None = None) -> Robot:
    return PI.model_copy(update={"registry": Registry(address=address, ca=ca)})


def chosen(*robots: Robot, to: str = "") -> Registry:
    return push._registry(robots, to)  # noqa: SLF001


def test_the_registry_is_the_robots_own_or_another(tmp_path: Path) -> None:
    """Of the same host, it is trusted in the same way."""
    ca = tmp_path / "ca.crt"
    ca.write_text("ca")
    assert chosen(robot("reg:5000/robots", ca), PI) == Registry(address="reg:5000/robots", ca=ca)
    assert chosen(robot("reg:5000/robots", ca), to="reg:5000/others") == Registry(
        address="reg:5000/others", ca=ca
    )
    assert chosen(robot("reg:5000/robots", ca), to="ghcr.io/tim") == Registry(address="ghcr.io/tim")


@pytest.mark.parametrize(
    ("robots", "to", "what"),
    [
        ((PI,), "", "the robots have none"),
        ((robot("a:1"), robot("b:1")), "", "the robots have several: a:1, b:1"),
        ((PI,), "nosuch", "--to must be a host"),
    ],
)
def test_a_registry_that_nobody_can_guess(robots: tuple[Robot, ...], to: str, what: str) -> None:
    """One sentence."""
    with pytest.raises(UsageError, match=what):
        chosen(*robots, to=to)
