from __future__ import annotations

import os
import random
import subprocess
from typing import TYPE_CHECKING

import pytest

from tests.support import lab_project
from tests.support.lab_project import (
    ANYWHERE,
    DOCKERFILE,
    LAB,
    Project,
    current,
    forget,
    on_each,
    prove,
    running,
    service,
    spool,
    wipe,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab
    from tests.support.lab_project import Said

NAME = f"{LAB}-layers"
LARGE, SMALL = 16_000_000, 50_000
"""Bytes of the payload and of the code, neither of which can be packed."""

LAYERS = DOCKERFILE.replace("COPY payload /", "COPY payload /payload\nCOPY model /model\nCOPY code /code")


@pytest.fixture(scope="module")
def fleet(engines: Lab, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Project]:
    """A project whose image has a large layer, a middling one above it, and code on top; one robot of each engine."""
    on_each(engines.pis, wipe)
    project = Project.made(tmp_path_factory.mktemp("layers"), engines)
    project.stack(tick=service(NAME, more=lab_project.built("layers"), times=ANYWHERE))
    project.write("layers/Dockerfile", LAYERS)
    for name, size in (("payload", LARGE), ("model", LARGE // 4), ("code", SMALL)):
        (project.directory / "layers" / name).write_bytes(random.Random(name).randbytes(size))  # noqa: S311
    project.well("build")
    yield project
    forget(NAME)


def change(project: Project, name: str, at: int) -> None:
    """Other bytes in the middle of a file of the image."""
    path = project.directory / "layers" / name
    content = bytearray(path.read_bytes())
    content[at : at + 16] = os.urandom(16)
    path.write_bytes(content)
    project.well("build")


def ship(project: Project, *arguments: str) -> Said:
    """Ship to all; every robot is done and runs the release that is current there."""
    said = project.well("ship", "--json", *arguments)
    assert set(said.status.values()) == {"done"}
    for pi in project.lab.pis:
        assert running(pi)["tick"][1] == current(pi)
        prove(pi)
    return said


def test_only_what_is_missing_travels(fleet: Project) -> None:
    """Whole layers first; then, after a change of the code, that layer alone, on every engine and store, bit for bit."""
    first = ship(fleet)
    assert all(LARGE < outcome["sent"] < LARGE * 1.6 for outcome in first.json)
    change(fleet, "code", 100)
    foreseen = {plan["robot"]: plan for plan in fleet.well("ship", "--dry", "--json").json["plans"]}
    second = ship(fleet)
    for outcome in second.json:
        assert SMALL < outcome["sent"] < SMALL + 40_000, outcome
        feeds = [step["feed"] for step in foreseen[outcome["robot"]]["steps"] if step["feed"]]
        pieces = [piece for feed in feeds for piece in feed.get("pieces", ())]
        sizes = [int(feed["data"].split()[0]) for feed in feeds if "data" in feed]
        sizes += [piece["size"] - piece["there"] for piece in pieces]
        assert abs(sum(sizes) - outcome["sent"]) < outcome["sent"] / 10
    assert [spool(pi) for pi in fleet.lab.pis] == [""] * len(fleet.lab.pis)


def test_the_image_it_came_from_may_go(fleet: Project) -> None:
    """`fab prune` removes what no release needs; layers that are shared stay, and the image can still be read whole."""
    change(fleet, "code", 200)
    ship(fleet)
    pruned = fleet.well("prune", "--keep", "2", "--json")
    assert set(pruned.status.values()) == {"done"}
    for pi in fleet.lab.pis:
        assert len(pi.exec("docker", "image", "ls", "--quiet", NAME).split()) == 2
        assert len(pi.exec("ls", "/home/pi/.fleet/stacks/tiny/releases").split()) == 2
        prove(pi)
    assert set(fleet.well("prune", "--keep", "2", "--json").status.values()) == {"unchanged"}


def test_inside_a_changed_layer_only_the_change_travels(fleet: Project) -> None:
    """Over a slow link: the large layer is made there with a patch, and the one above it is found there."""
    change(fleet, "payload", LARGE // 2)
    said = ship(fleet, "--limit", "8Mbit")
    for outcome in said.json:
        assert outcome["sent"] < SMALL + 150_000, (outcome, said.err)


def test_a_robot_that_cannot_be_believed_is_sent_the_layer(fleet: Project) -> None:
    """Its old layer was damaged: the patch does not come out right, which is noticed before Docker sees it."""
    pi = next(pi for pi in fleet.lab.pis if pi.name == "e26")
    change(fleet, "payload", LARGE // 3)
    damage = "for f in /var/lib/docker/overlay2/*/diff/payload; do printf damaged | dd of=$f conv=notrunc status=none; done"
    pi.exec("sh", "-c", damage)
    said = fleet.fab("ship", "--hosts", "e26", "--limit", "16Mbit", "--json")
    assert said.status == {"e26": "done"}, said.all
    assert "trying another way" in said.err
    prove(pi)


def test_an_image_that_goes_before_its_layers_come(fleet: Project) -> None:
    """What was to be left out is no longer there: Docker says so, the robot is looked at again, and gets what it lacks."""
    change(fleet, "code", 300)
    pi = next(pi for pi in fleet.lab.pis if pi.name == "e28")
    held = ("docker", "exec", pi.container, "flock", "/home/pi/.fleet/spool/lock", "sleep", "61")
    with fleet.start("ship", "--hosts", "e28", "--json") as fab, subprocess.Popen(held) as other:
        fab.await_text("wait for somebody")
        gone = f"docker ps -aq | xargs docker rm -f; docker image ls -q {NAME} | xargs docker image rm -f"
        pi.exec("sh", "-c", gone)
        pi.exec("pkill", "-f", "sleep 61")
        other.wait(10)
        said = fab.end(within=100)
    assert said.status == {"e28": "done"}, said.all
    assert "trying another way" in said.err
    prove(pi)
