from __future__ import annotations

import pytest

from fleet.config.inventory import Docker, Robot
from fleet.errors import NotReady
from fleet.provision import jetson
from tests.support.samples import PI, facts

ORIN = {"model": "NVIDIA Jetson Orin Nano", "l4t": "36.4.0"}
PINNED = Robot(name="pi1", address="pi1.local", docker=Docker(version="27.5.1"))


@pytest.mark.parametrize(
    ("seen", "major"),
    [
        ({"raw_table": True, **ORIN}, None),
        ({"raw_table": None}, None),
        ({"raw_table": False, **ORIN}, 27),
        ({"raw_table": None, **ORIN}, 27),
        ({"raw_table": None, **ORIN, "docker_state": "ready"}, 28),
        ({"raw_table": None, **ORIN, "docker_state": "forbidden"}, 28),
    ],
)
def test_a_version_that_works(seen: dict[str, object], major: int | None) -> None:
    """The kernel has the table, or the version does not need it, or it runs already and nothing is known against it."""
    jetson.check_version(PI, facts(**seen), major=major)


@pytest.mark.parametrize(
    ("seen", "major", "what", "cure"),
    [
        (
            {"raw_table": False, **ORIN, "docker_state": "absent", "docker_version": "", "client": ""},
            None,
            (
                "the kernel of this NVIDIA Jetson Orin Nano has no iptables table `raw`: without it Docker 28 and newer do not "
                "start, or publish no ports"
            ),
            "write `docker: {version: 27.5.1}` for pi1 in the inventory; then run the same command again",
        ),
        (
            {"raw_table": None, **ORIN, "docker_state": "absent", "docker_version": "", "client": ""},
            29,
            (
                "the kernel of this NVIDIA Jetson Orin Nano may have no iptables table `raw`: without it Docker 28 and newer do "
                "not start, or publish no ports"
            ),
            "write `docker: {version: 27.5.1}` for pi1 in the inventory; then run the same command again",
        ),
        (
            {"raw_table": False, "docker_version": "28.1.0"},
            28,
            (
                "Docker 28.1.0 is installed, and the kernel of this robot has no iptables table `raw`: without it Docker 28 and "
                "newer do not start, or publish no ports"
            ),
            (
                "write `docker: {version: 27.5.1}` for pi1 in the inventory; remove Docker on the robot (its containers stop; "
                "images stay); then run the same command again"
            ),
        ),
    ],
)
def test_a_version_that_does_not_work(
    seen: dict[str, object], major: int | None, what: str, cure: str
) -> None:
    """It is refused before anything is installed, with the line to write."""
    with pytest.raises(NotReady) as refused:
        jetson.check_version(PI, facts(**seen), major=major)
    assert (refused.value.what, refused.value.cure) == (what, cure)


def test_the_runtime_is_wanted_where_its_toolkit_is() -> None:
    """Docker is told once, and a running one reads it without stopping containers."""
    without = facts(toolkit=True, runtimes=("runc",))
    assert [step.argv for step in jetson.reload(without)] == [("sudo", "-n", "systemctl", "reload", "docker")]
    assert [step.expect for step in jetson.proof(without)] == ["nvidia"]
    for seen in (facts(toolkit=True, runtimes=("runc", "nvidia")), facts(runtimes=("runc",))):
        assert (jetson.wants_runtime(seen), jetson.reload(seen), jetson.proof(seen)) == (False, (), ())
    assert jetson.reload(facts(toolkit=True, docker_state="absent")) == ()


def test_the_runtime_joins_what_is_there() -> None:
    """A runtime of that name is a person's own, and stays."""
    own = {"nvidia": {"path": "/opt/nvidia"}, "crun": {"path": "crun"}}
    assert jetson.with_runtime({"dns": ["1.1.1.1"], "runtimes": own}) == {"dns": ["1.1.1.1"], "runtimes": own}
    assert jetson.with_runtime({})["runtimes"] == {"nvidia": {"args": [], "path": "nvidia-container-runtime"}}
