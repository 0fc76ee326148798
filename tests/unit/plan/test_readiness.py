from __future__ import annotations

import pytest

from fleet.errors import NotReady
from fleet.plan.readiness import ready
from tests.support.samples import PI, facts


@pytest.mark.parametrize(
    ("values", "what", "cure"),
    [
        ({"docker_state": "absent"}, "Docker is not installed", "`fab provision --hosts pi1`"),
        (
            {"docker_state": "stopped"},
            "Docker is installed and not running",
            "`fab provision --hosts pi1`, or see `journalctl -u docker` there",
        ),
        (
            {"docker_state": "forbidden"},
            "pi may not use Docker",
            "`fab provision --hosts pi1` puts the login into the docker group",
        ),
        ({"compose": ""}, "Docker's Compose plugin is missing", "`fab provision --hosts pi1`"),
        (
            {"userland": "armhf"},
            "it runs linux/arm/v7, and the inventory says linux/arm64",
            "set `platform: linux/arm/v7` for pi1",
        ),
        (
            {"machine": "x86_64", "userland": "amd64", "emulates": ("qemu-arm",)},
            "it runs linux/amd64 and linux/arm/v7, and the inventory says linux/arm64",
            "set `platform: linux/amd64` for pi1",
        ),
        (
            {"machine": "armv6l", "userland": "armhf"},
            "it runs armv6l, and the inventory says linux/arm64",
            "",
        ),
    ],
)
def test_a_robot_that_cannot_run_containers_is_refused_with_the_cure(
    values: dict[str, object], what: str, cure: str
) -> None:
    """Before anything is planned."""
    with pytest.raises(NotReady) as caught:
        ready(facts(**values), robot=PI)
    assert (caught.value.what, caught.value.cure) == (what, cure)


def test_a_robot_that_is_ready_passes() -> None:
    """Its own platform, and those that it emulates."""
    ready(facts(), robot=PI)
    ready(facts(machine="x86_64", userland="amd64", emulates=("qemu-aarch64",)), robot=PI)
