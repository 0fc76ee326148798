from __future__ import annotations

import json
import subprocess
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import LAB, Project, current, eventually, forget, on_each, running, wipe

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi
    from tests.support.lab_project import Said

IMAGE = f"{LAB}-main"
ALL = ("pi1", "pi2", "pi3")
SLOW = 400.0  # seconds: three ARM images start at once, emulated, on a desktop that may have two cores


@dataclass(frozen=True, kw_only=True)
class Talking:
    """The project's own robots after the main job, and what its verbs said."""

    project: Project
    built: Said
    shipped: Said


@pytest.fixture(scope="module")
def talking(provisioned: Lab, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Talking]:
    """The main job: this repository's own stack, built and shipped to every robot of the lab."""
    on_each(provisioned.pis, wipe)
    project = Project.copied(tmp_path_factory.mktemp("main-job"), provisioned, image=IMAGE)
    built = project.well("build", "--json", within=900)
    yield Talking(
        project=project,
        built=built,
        shipped=project.well("ship", "--hosts", "fleet", "--json", within=SLOW),
    )
    on_each(provisioned.pis, wipe)
    forget(IMAGE)


def container(pi: Pi) -> str:
    return running(pi)["talker"][0]


def heard(project: Project, *arguments: str) -> dict[str, str]:
    """What `fab listen` hears first from each robot."""
    said = project.well("listen", "--count", "1", "--timeout", "60", *arguments)
    lines = (line.partition("|") for line in said.out.splitlines())
    return {name.strip(): text.strip() for name, _, text in lines}


def test_every_robot_is_shipped_to_and_healthy(talking: Talking) -> None:
    """Three done, and `fab status` is content."""
    assert talking.shipped.status == dict.fromkeys(ALL, "done")
    status = talking.project.well("status", "--json").json
    assert {name: robot["healthy"] for name, robot in status.items()} == dict.fromkeys(ALL, True)


def test_the_image_is_for_arm_and_small(talking: Talking) -> None:
    """linux/arm64 and at most 260 MB, here and on every robot."""
    (image,) = talking.built.json
    assert image["platform"] == "linux/arm64"
    assert image["size"] <= 260_000_000
    form = "{{.Os}}/{{.Architecture}} {{.Size}}"
    for pi in talking.project.lab.pis:
        name = pi.exec("docker", "inspect", "--format", "{{.Config.Image}}", container(pi))
        platform, size = pi.exec("docker", "image", "inspect", "--format", form, name).split()
        assert platform == "linux/arm64"
        assert int(size) <= 260_000_000


def test_shipping_again_sends_nothing(talking: Talking) -> None:
    """Unchanged, three times, and no byte."""
    said = talking.project.well("ship", "--hosts", "fleet", "--json")
    assert said.status == dict.fromkeys(ALL, "unchanged")
    assert sum(outcome["sent"] for outcome in said.json) == 0


def test_every_robot_has_its_own_ros_name(talking: Talking) -> None:
    """ROS_HOSTNAME is what others call this robot, and no other's."""
    for pi in talking.project.lab.pis:
        variables = json.loads(
            pi.exec("docker", "inspect", "--format", "{{json .Config.Env}}", container(pi))
        )
        assert f"ROS_HOSTNAME={pi.address}" in variables


def test_the_desktop_hears_every_robot(talking: Talking) -> None:
    """One message from each, under its own name."""
    assert all(text.startswith('data: "20') for text in heard(talking.project).values())
    assert sorted(heard(talking.project)) == list(ALL)


def test_robots_hear_each_other(talking: Talking) -> None:
    """`rostopic echo` on one robot, asked for the next robot's /time, prints a message."""
    pis = talking.project.lab.pis
    listeners = dict(zip(pis, (*pis[1:], pis[0]), strict=True))

    def listen(pi: Pi) -> str:
        master = f"ROS_MASTER_URI=http://{listeners[pi].address}:11311"
        inner = ("docker", "exec", "--env", master, container(pi), "rostopic", "echo", "-n1", "/time")
        return pi.exec(*inner, timeout=SLOW)

    assert [text.partition(" ")[0] for text in on_each(pis, listen)] == ["data:", "data:", "data:"]


def test_a_robot_that_was_switched_off_and_on_talks_again(talking: Talking) -> None:
    """Nobody helps it: Docker starts at boot, and the container with it."""
    pi = talking.project.lab.pis[0]
    subprocess.run(("docker", "restart", "--time", "5", pi.container), capture_output=True, check=True)

    def listen() -> bool:
        return talking.project.fab("listen", "--hosts", pi.name, "--count", "1").code == 0

    assert eventually(listen, within=SLOW)


def test_a_second_release_and_back(talking: Talking, capsys: pytest.CaptureFixture[str]) -> None:
    """One line of the node changes: built in seconds, shipped to one robot, heard; rolled back, the first one is heard again.

    The other robots are as they were.
    """
    project, first = talking.project, [current(pi) for pi in talking.project.lab.pis]
    project.edit(
        "talker/src/talker/clock.py", "return moment.isoformat", 'return "second " + moment.isoformat'
    )
    started = time.monotonic()
    project.well("build")
    took = time.monotonic() - started
    with capsys.disabled():
        print(f"\nfab build after a change of one line: {took:.1f} s")  # noqa: T201  the figure is a result
    assert took < 15
    one, *others = ALL
    assert project.well("ship", "--hosts", one, "--json", within=SLOW).status == {one: "done"}
    second = [current(pi) for pi in project.lab.pis]
    assert (second[0] != first[0], second[1:]) == (True, first[1:])
    assert {name: '"second ' in text for name, text in heard(project).items()} == {
        one: True,
        **dict.fromkeys(others, False),
    }
    assert project.well("rollback", "--hosts", one, "--json", within=SLOW).status == {one: "done"}
    assert [current(pi) for pi in project.lab.pis] == first
    assert not any('"second ' in text for text in heard(project).values())
    told = project.well("history", "--json").json
    events = {
        name: [(event["verb"], event["release"], event["outcome"]) for event in told[name]] for name in ALL
    }
    shipped = {name: [("ship", release, "done")] for name, release in zip(ALL, first, strict=True)}
    assert events == {
        **shipped,
        one: [*shipped[one], ("ship", second[0], "done"), ("rollback", first[0], "done")],
    }
