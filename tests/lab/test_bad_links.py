from __future__ import annotations

import subprocess
import time
from typing import TYPE_CHECKING

from tests.support.lab_project import (
    HEAVY,
    HEAVY_SIZE,
    current,
    cut,
    environment,
    eventually,
    processes,
    running,
    service,
    spooled,
)

if TYPE_CHECKING:
    from tests.lab.conftest import Pi
    from tests.support.lab_project import Project

HALF = HEAVY_SIZE // 2
STARTING = service(check="false").replace("start_period: 20s", "start_period: 600s")
"""A service that never becomes healthy, and may take ten minutes to: `up --wait` waits for it."""


def images(pi: Pi) -> str:
    return pi.exec("docker", "image", "ls", "--quiet", HEAVY)


def shipped(project: Project, colour: str = "red") -> list[tuple[str, dict[str, tuple[str, str]]]]:
    """Ship a good release to all; what is current and what runs on each."""
    project.colour(colour)
    project.well("ship")
    return [(current(pi), running(pi)) for pi in project.lab.pis]


def test_a_link_cut_in_mid_stream(project: Project, pi: Pi) -> None:
    """Noticed within 30 s; the others are done, what ran runs on, and the next ship sends the rest."""
    before = shipped(project)
    project.stack(tick=service(HEAVY))
    with cut(pi, after=HALF) as is_cut, project.start("ship", "--json", "--retry-for", "0") as fab:
        assert eventually(is_cut, within=60)
        since = time.monotonic()
        said = fab.end()
        assert time.monotonic() - since < 30
    assert (said.code, said.status) == (1, {"pi1": "failed", "pi2": "done", "pi3": "done"})
    assert said.json[0]["step"].startswith("send ")
    assert "run the same command again" in said.json[0]["cure"]
    assert (current(pi), running(pi)) == before[0]
    arrived = spooled(pi)
    assert arrived > HALF * 0.8
    again = project.well("ship", "--json")
    assert again.status == {"pi1": "done", "pi2": "unchanged", "pi3": "unchanged"}
    assert again.json[0]["sent"] < HEAVY_SIZE + 100_000 - arrived
    assert spooled(pi) == 0


def test_a_link_that_comes_back(project: Project, pi: Pi) -> None:
    """The command goes on by itself where it was; hardly more is sent than without the cut."""
    shipped(project)
    project.stack(tick=service(HEAVY))
    with project.start("ship", "--json") as fab:
        with cut(pi, after=HALF) as is_cut:
            assert eventually(is_cut, within=60)
            fab.await_text("pi1: nothing was heard from the robot for")
        said = fab.end(within=90)
    assert (said.code, said.status) == (0, dict.fromkeys(("pi1", "pi2", "pi3"), "done"))
    assert said.json[0]["sent"] < HEAVY_SIZE * 1.1
    assert "trying again for" in said.err


def test_a_link_cut_in_mid_command(project: Project, pi: Pi) -> None:
    """Noticed within 30 s; the robot goes on by itself, goes back, and the next ship is what it should be."""
    before = shipped(project)[0][0]
    project.stack(tick=STARTING)
    with project.start("ship", "--hosts", "pi1", "--retry-for", "0", "--wait", "40") as fab:
        assert eventually(lambda: processes(pi, "swap ship tiny"))
        with cut(pi):
            since = time.monotonic()
            said = fab.end()
            assert time.monotonic() - since < 30
    assert said.code == 1
    assert "start release" in said.out
    assert "the robot goes on by itself" in said.out
    assert eventually(lambda: not processes(pi, "swap ship tiny"), within=120)
    assert (current(pi), running(pi)["tick"][1]) == (before, before)
    project.stack(tick=service())
    project.colour("green")
    project.well("ship", "--hosts", "pi1")
    assert environment(pi)["COLOUR"] == "green"


def test_docker_that_dies_during_the_load(project: Project, pi: Pi) -> None:
    """What has arrived is there: once the engine is back, it is loaded again, and nothing is sent twice."""
    shipped(project)
    project.stack(tick=service(HEAVY))
    with project.start("ship", "--json") as fab:
        fab.await_text("pi1: load the image into Docker")
        pi.exec("systemctl", "kill", "--signal", "KILL", "docker")
        said = fab.end(within=120)
    assert (said.code, said.status) == (0, dict.fromkeys(("pi1", "pi2", "pi3"), "done"))
    assert said.json[0]["sent"] < HEAVY_SIZE * 1.1


def test_ctrl_c_while_connecting(project: Project, pi: Pi) -> None:
    """A robot that accepts the connection but sends no SSH banner does not hold the person."""
    subprocess.run(("docker", "pause", pi.container), capture_output=True, check=True)
    try:
        with project.start("ship", "--hosts", "pi1") as fab:
            fab.await_text("look at the robot")
            fab.ctrl_c()
            said = fab.end(within=5)
    finally:
        subprocess.run(("docker", "unpause", pi.container), capture_output=True, check=True)
    assert (said.code, "interrupted by Ctrl-C" in said.out, "Traceback" in said.all) == (1, True, False), said


def test_ctrl_c_while_looking(project: Project, pi: Pi) -> None:
    """A robot whose Docker hangs does not hold the person; those that are through are told as they are."""
    pi.exec("systemctl", "kill", "--signal", "STOP", "docker")
    try:
        with project.start("ship") as fab:
            fab.await_text("pi2: done")
            fab.await_text("pi3: done")
            assert processes(pi, "docker version")
            fab.ctrl_c()
            said = fab.end(within=5)
    finally:
        pi.exec("systemctl", "kill", "--signal", "CONT", "docker")
    assert said.code == 1
    assert [line.split()[:2] for line in said.out.splitlines() if line.startswith("pi")] == [
        ["pi1", "skipped"],
        ["pi2", "done"],
        ["pi3", "done"],
    ]
    assert (current(pi), running(pi)) == ("", {})


def test_ctrl_c_while_bytes_flow(project: Project, pi: Pi) -> None:
    """What ran runs on, no half an image stays, and the next ship sends the rest."""
    before = shipped(project)
    project.stack(tick=service(HEAVY))
    with project.start("ship", "--hosts", "pi1", "--limit", "40Mbit") as fab:
        assert eventually(lambda: spooled(pi) > 5_000_000)
        fab.ctrl_c()
        said = fab.end(within=5)
    assert (said.code, "interrupted by Ctrl-C" in said.out, "Traceback" in said.all) == (1, True, False), said
    assert eventually(lambda: not processes(pi, "receive what is missing"))
    assert (images(pi), current(pi), running(pi)) == ("", *before[0])
    arrived = spooled(pi)
    (outcome,) = project.well("ship", "--hosts", "pi1", "--json").json
    assert outcome["sent"] < HEAVY_SIZE + 100_000 - arrived


def test_two_ships_at_once(project: Project, pi: Pi) -> None:
    """The second waits for the first, whom it names, and then finds that all is there."""
    project.stack(tick=service(HEAVY))
    with project.start("ship", "--hosts", "pi1", "--limit", "20Mbit") as first:
        assert eventually(lambda: spooled(pi) > 1_000_000)
        with project.start("ship", "--hosts", "pi1") as second:
            second.await_text("who is shipping to this robot")
            assert second.end(within=100).code == 0
        assert first.end().code == 0
    assert list(running(pi)) == ["tick"]


def test_ctrl_c_during_the_start(project: Project, pi: Pi) -> None:
    """The robot goes on by itself, which is said: a release that does not become healthy is taken back there."""
    before = shipped(project)[0][0]
    project.stack(tick=STARTING)
    with project.start("ship", "--hosts", "pi1", "--wait", "15") as fab:
        assert eventually(lambda: processes(pi, "swap ship tiny"))
        fab.ctrl_c()
        said = fab.end(within=5)
    assert (said.code, "interrupted by Ctrl-C" in said.out, "Traceback" in said.all) == (1, True, False), said
    assert "the robot goes on by itself" in said.out
    assert eventually(lambda: not processes(pi, "swap ship tiny"), within=60)
    assert (current(pi), running(pi)["tick"][1]) == (before, before)
    project.stack(tick=service())
    project.colour("green")
    project.well("ship", "--hosts", "pi1")
    assert environment(pi)["COLOUR"] == "green"
    assert not processes(pi, "swap ship tiny")
