from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.config.registry import Registry
from tests.support.inventory_files import inventory, problems

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """People run `fab` where the inventory is; messages name files from there."""
    monkeypatch.chdir(tmp_path)
    for name in ("ca", "crt", "key"):
        (tmp_path / name).write_text(name)
    return tmp_path


def test_robots_pull_only_if_somebody_says_so(folder: Path) -> None:
    """For all, a group or one robot; keys are merged, and files are found beside the inventory."""
    robots = inventory("""
defaults: {registry: {address: "reg.local:5000/robots", ca: ca}}
groups: {site: {robots: [pi1, pi2], transport: registry}}
robots:
  pi1: {registry: {address: "10.0.0.5:5000", client_cert: crt, client_key: key, user: tim, token: TOKEN}}
  pi2: {transport: ssh}
  pi3:
""").robots
    assert [one.transport for one in robots.values()] == ["registry", "ssh", "ssh"]
    assert robots["pi1"].registry == Registry(
        address="10.0.0.5:5000",
        ca=folder / "ca",
        client_cert=folder / "crt",
        client_key=folder / "key",
        user="tim",
        token="TOKEN",  # noqa: S106  a variable's name
    )
    assert robots["pi3"].registry == Registry(address="reg.local:5000/robots", ca=folder / "ca")


@pytest.mark.parametrize(
    ("said", "what"),
    [
        ("{address: registry}", "must be a host with a port or a dot in its name"),
        ('{address: "https://reg.local"}', "must be a host with a port or a dot in its name"),
        ('{address: "reg.local/Robots"}', "must be a host with a port or a dot in its name"),
        ('{address: "reg.local:99999"}', "must be a host with a port or a dot in its name"),
        ("{ca: ca}", "registry.address: is missing"),
        ("{address: reg.local, client_cert: crt}", "client_cert and client_key go together"),
        ("{address: reg.local, ca: nosuch}", "no such file"),
        ("{address: reg.local, token: my-token}", "registry.token"),
        ("{address: reg.local, cert: x}", "no such key"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(said: str, what: str) -> None:
    """With its place."""
    (problem,) = problems(f"robots: {{pi1: {{registry: {said}}}}}")
    assert what in problem


def test_there_are_two_transports() -> None:
    """Not those of another key."""
    (problem,) = problems("robots: {pi1: {transport: usb}}")
    assert problem.endswith("robots.pi1.transport: must be ssh or registry, not usb")


def test_an_address_has_a_host_and_a_path() -> None:
    """Docker calls the registry by the host; images are below the path."""
    assert (Registry(address="r.io/a/b").host, Registry(address="r.io/a/b").prefix) == ("r.io", "a/b/")
    assert Registry(address="r:5000").prefix == ""
