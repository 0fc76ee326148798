from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import pytest

from fleet.config.compose import LEVELS, Project, Resolved
from fleet.config.stack import Mount, Service, Stack, literal, read, seconds
from fleet.errors import ComposeError

ABOVE = Path("/tmp/t").joinpath(*["up"] * LEVELS)
HERE = f"{ABOVE}/robot"
PROJECT = Project(files=(Path("robot/compose.yaml"),), real=Path("/home/tim/robot"), folder=ABOVE / "robot")


def stack(model: dict[str, Any]) -> Stack:
    return read(Resolved(model={"name": "robot", **model}), PROJECT)


def service(**value: Any) -> Service:  # noqa: ANN401
    return stack({"services": {"a": {"image": "x", **value}}}).services["a"]


def test_a_service_as_plain_as_it_can_be() -> None:
    """Compose's defaults."""
    assert service() == Service(name="a", image="x")


def test_image_platform_and_build() -> None:
    """A service that is built and has no image gets Compose's default name."""
    build = {"context": HERE, "dockerfile": "Dockerfile"}
    found = stack({"services": {"b-c": {"build": build, "platform": "linux/arm64"}}}).services["b-c"]
    assert found == Service(name="b-c", image="robot-b-c", platform="linux/arm64", build=build)


def test_a_digest_stays_one() -> None:
    """The reference is not shortened."""
    image = f"ros@sha256:{'0' * 64}"
    assert service(image=image).image == image


@pytest.mark.parametrize(
    ("value", "restart"),
    [
        ({}, "no"),
        ({"restart": "no"}, "no"),
        ({"restart": "always"}, "always"),
        ({"restart": "unless-stopped"}, "always"),
        ({"restart": "on-failure"}, "on-failure"),
        ({"restart": "on-failure:3"}, "on-failure"),
        ({"deploy": {"restart_policy": {"condition": "any"}}}, "always"),
        ({"deploy": {"restart_policy": {}}}, "no"),
        ({"deploy": {"restart_policy": {"condition": "none"}}}, "no"),
        ({"deploy": {"restart_policy": {"condition": "on-failure"}}}, "on-failure"),
        ({"restart": "always", "deploy": {"restart_policy": {"condition": "none"}}}, "always"),
        ({"deploy": None}, "no"),
    ],
)
def test_restart(value: dict[str, Any], restart: str) -> None:
    """``restart:`` comes before ``deploy``; a policy without a condition is none."""
    assert service(**value).restart == restart


@pytest.mark.parametrize(
    ("value", "retries"),
    [
        ({"restart": "on-failure:3"}, 3),
        ({"restart": "on-failure"}, 0),
        ({"restart": "always", "deploy": {"restart_policy": {"max_attempts": 3}}}, 0),
        ({"deploy": {"restart_policy": {"condition": "on-failure", "max_attempts": 4}}}, 4),
    ],
)
def test_retries(value: dict[str, Any], retries: int) -> None:
    """Only `on-failure` has a limit."""
    assert service(**value).retries == retries


@pytest.mark.parametrize(
    ("value", "replicas"),
    [
        ({"scale": 0}, 0),
        ({"scale": 3}, 3),
        ({"deploy": {"replicas": 0}}, 0),
        ({"deploy": {"replicas": 2}}, 2),
        ({"deploy": {"replicas": None}}, 1),
        ({"deploy": {}}, 1),
    ],
)
def test_replicas(value: dict[str, Any], replicas: int) -> None:
    """0 is a number too."""
    assert service(**value).replicas == replicas


@pytest.mark.parametrize(
    ("check", "checked", "start_period"),
    [
        (None, None, 0.0),
        ({"test": ["CMD", "true"]}, True, 0.0),
        ({"test": ["CMD", "true"], "start_period": "1m30s"}, True, 90.0),
        ({"start_period": "40s"}, True, 40.0),
        ({"disable": True}, False, 0.0),
        ({"test": ["NONE"], "start_period": "40s"}, False, 0.0),
        ({"disable": True, "start_period": "40s"}, False, 0.0),
    ],
)
def test_health_check(check: dict[str, Any] | None, checked: bool | None, start_period: float) -> None:
    """The file has one, switches the image's off, or leaves it to the image."""
    found = service(**({} if check is None else {"healthcheck": check}))
    assert (found.checked, found.start_period) == (checked, start_period)


def test_the_longest_start_period() -> None:
    """The whole stack waits for the slowest."""
    checks = {name: {"image": "x", "healthcheck": {"start_period": f"{name}s"}} for name in ("5", "70", "8")}
    assert stack({"services": checks}).start_period == 70.0


@pytest.mark.parametrize(
    ("text", "number"),
    [("0s", 0), ("90s", 90), ("1m30s", 90), ("1h0m0.5s", 3600.5), ("250ms", 0.25), ("1.5h", 5400), ("5us", 5e-6)],
)  # fmt: skip
def test_durations(text: str, number: float) -> None:
    """As Go writes them."""
    assert seconds(text) == pytest.approx(number)


def test_mounts_of_every_kind() -> None:
    """Bind mounts, a volume that is a folder of the project, configs and secrets; never what is the robot's own."""
    value = {
        "image": "x",
        "volumes": [
            {"type": "bind", "source": f"{HERE}/maps", "target": "/maps", "bind": {}},
            {"type": "bind", "source": f"{HERE}/nav.yaml", "target": "/nav", "read_only": True},
            {"type": "bind", "source": f"{ABOVE}/o", "target": "/o"},
            {"type": "bind", "source": HERE, "target": "/ws"},
            {"type": "bind", "source": f"{HERE}/a$$b", "target": "/d"},
            {"type": "bind", "source": "/dev", "target": "/dev"},
            {"type": "volume", "source": "data", "target": "/data"},
            {"type": "volume", "source": "local", "target": "/local", "read_only": True},
            {"type": "volume", "target": "/anonymous"},
            {"type": "tmpfs", "target": "/tmp"},
        ],
        "configs": [{"source": "c", "target": "/etc/c"}, {"source": "inline"}, {"source": "plain"}],
        "secrets": [{"source": "s", "target": "/run/secrets/s"}, {"source": "out"}],
    }
    model = {
        "services": {"a": value},
        "volumes": {"data": None, "local": {"driver_opts": {"type": "none", "o": "bind", "device": f"{HERE}/l"}}},
        "configs": {
            "c": {"file": f"{HERE}/c.conf"},
            "inline": {"content": "text"},
            "plain": {"file": f"{HERE}/plain"},
        },
        "secrets": {"s": {"file": f"{HERE}/s.key"}, "out": {"external": True, "name": "out"}},
    }  # fmt: skip

    def mount(path: str, target: str, *, read_only: bool = False, **kind: Any) -> Mount:  # noqa: ANN401
        return Mount(service="a", path=PurePosixPath(path), target=target, read_only=read_only, **kind)

    assert set(stack(model).mounts) == {
        mount("maps", "/maps"),
        mount("nav.yaml", "/nav", read_only=True),
        mount("../o", "/o"),
        mount(".", "/ws"),
        mount("a$b", "/d"),
        mount("l", "/local"),  # Docker keeps a volume as it was made: it cannot be in a release
        mount("c.conf", "/etc/c", read_only=True, kind="config"),
        mount("plain", "/plain", read_only=True, kind="config"),
        mount("s.key", "/run/secrets/s", read_only=True, kind="secret"),
    }


def test_a_dollar_in_a_reference() -> None:
    """Compose writes it twice."""
    assert literal("a$$b$$$$c") == "a$b$$c"


@pytest.mark.parametrize("services", [None, {}])
def test_a_stack_without_a_service(services: dict[str, Any] | None) -> None:
    """Its profile may not be active."""
    with pytest.raises(ComposeError) as caught:
        stack({"services": services})
    assert caught.value.what == "robot/compose.yaml: there is no service in it, or its profile is not active"
    assert "COMPOSE_PROFILES" in caught.value.cure
