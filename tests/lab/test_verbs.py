from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

from tests.support.lab_project import current, eventually, on_each, processes, running, service

if TYPE_CHECKING:
    from tests.lab.conftest import Pi
    from tests.support.lab_project import Project

ALL = ("pi1", "pi2", "pi3")


def compose_logs(pi: Pi) -> list[str]:
    return processes(pi, "compose.* logs")


def test_status_tells_programs_and_people(project: Project, pi: Pi) -> None:
    """Exit code 0 while all is well; 1, and why, when a container is not there."""
    project.well("ship")
    said = project.well("status", "--json").json
    assert {
        name: (robot["reachable"], robot["healthy"], robot["fleet"]["stacks"]["tiny"]["current"])
        for name, robot in said.items()
    } == {pi.name: (True, True, current(pi)) for pi in project.lab.pis}
    pi.exec("docker", "rm", "--force", running(pi)["tick"][0])
    table = project.fab("status")
    assert table.code == 1
    rows = {line.split()[0]: line for line in table.out.splitlines()[1:]}
    assert "tick has no container" in rows["pi1"]
    assert "tick healthy" in rows["pi2"]


def test_status_of_a_robot_that_is_off(project: Project, pi: Pi) -> None:
    """It is told as off, within the time a person waits; the others are shown."""
    project.well("ship")
    subprocess.run(("docker", "pause", pi.container), capture_output=True, check=True)
    try:
        said = project.fab("status", "--json", within=30)
    finally:
        subprocess.run(("docker", "unpause", pi.container), capture_output=True, check=True)
    assert (said.code, [robot["reachable"] for robot in said.json.values()]) == (1, [False, True, True])


def test_logs_of_all_robots(project: Project) -> None:
    """Merged, each line with its robot's name, as many as were asked for."""
    project.colour("red")
    project.well("ship")
    said = project.well("logs", "--tail", "1")
    assert sorted(said.out.splitlines()) == [f"{name} | tick red" for name in ALL]


def test_a_follower_ends_with_ctrl_c_and_leaves_nothing_behind(project: Project) -> None:
    """New lines come as they are said; afterwards no process of it runs on any robot."""
    project.well("ship")
    with project.start("logs", "--follow", "--tail", "0") as fab:
        for name in ALL:
            fab.await_text(f"{name} | tick")
        assert all(on_each(project.lab.pis, compose_logs))
        fab.ctrl_c()
        said = fab.end(within=5)
    assert (said.code, said.err) == (0, "")
    assert eventually(lambda: not any(on_each(project.lab.pis, compose_logs)))


def test_a_follower_that_is_killed_leaves_nothing_behind(project: Project) -> None:
    """The terminal window is closed, the laptop sleeps: the robot notices."""
    project.well("ship", "--hosts", "pi1")
    with project.start("logs", "--follow", "--hosts", "pi1") as fab:
        fab.await_text("pi1 | tick")
    assert eventually(lambda: not compose_logs(project.lab.pis[0]))


def test_stop_start_and_restart(project: Project, pi: Pi) -> None:
    """Each does what it says, says unchanged when it is so already, and is in the history."""
    project.well("ship", "--hosts", "pi1")
    release = current(pi)
    told = [
        project.well(verb, "--hosts", "pi1", "--json").status["pi1"]
        for verb in ("stop", "stop", "start", "start", "restart")
    ]
    assert told == ["done", "unchanged", "done", "unchanged", "done"]
    assert running(pi)["tick"][1] == release
    history = project.well("history", "--hosts", "pi1", "--json").json["pi1"]
    assert [event["verb"] for event in history] == ["ship", "stop", "start", "restart"]


def test_what_is_stopped_stays_stopped_over_a_reboot(project: Project, pi: Pi) -> None:
    """A person who stopped a robot's motors does not want them back with the power."""
    project.well("ship", "--hosts", "pi1")
    project.well("stop", "--hosts", "pi1")
    subprocess.run(("docker", "restart", "--time", "2", pi.container), capture_output=True, check=True)
    assert eventually(lambda: pi.ssh("docker version").returncode == 0)
    assert running(pi) == {}


def test_run_on_all_robots(project: Project) -> None:
    """The shell's line runs on each; what fails somewhere fails the command, and is told with its code."""
    said = project.well("run", "--", "hostname; echo oops >&2")
    assert sorted(said.out.splitlines()) == sorted(f"{n} | {text}" for n in ALL for text in (n, "oops"))
    failed = project.fab("run", "--hosts", "pi1,pi2", "--", "test $(hostname) = pi1")
    assert failed.code == 1
    assert "pi2: ended with code 1" in failed.err
    assert "pi1" not in failed.err


def test_a_verb_without_a_release_says_ship(project: Project) -> None:
    """Nothing was ever sent: exit code 1, and the verb that does it."""
    for line in (("start",), ("stop",), ("restart",), ("logs",), ("rollback",)):
        said = project.fab(*line, "--hosts", "pi1")
        assert said.code == 1, (line, said)
        assert "ship" in said.all or "history" in said.all, (line, said)


def test_two_stacks_run_beside_each_other(project: Project, pi: Pi) -> None:
    """Ship, logs, rollback and remove of one leave the other's containers running, with the same IDs."""
    project.well("ship", "--hosts", "pi1")
    first = running(pi)["tick"]
    path = project.directory / "docker" / "compose.yaml"
    path.write_text(path.read_text().replace("name: tiny", "name: other").replace("tick:", "tock:"))
    for colour in ("red", "green"):
        project.colour(colour)
        project.well("ship", "--hosts", "pi1")
    assert project.well("ship", "--hosts", "pi1", "--json").status == {"pi1": "unchanged"}
    assert running(pi)["tick"] == first
    assert "tick" in project.well("logs", "--hosts", "pi1", "--stack", "tiny", "--tail", "1").out
    project.well("rollback", "--hosts", "pi1", "--stack", "other")
    assert (running(pi)["tick"], len(running(pi))) == (first, 2)
    assert "--stack" in project.fab("logs", "--hosts", "pi1").all
    project.well("remove", "--hosts", "pi1", "--stack", "other")
    assert running(pi) == {"tick": first}
    assert project.well("status", "--hosts", "pi1")


def test_the_container_healthcheck_of_the_image_counts(project: Project, pi: Pi) -> None:
    """A container that becomes unhealthy later is told by status."""
    project.stack(tick=service(check="[ ! -e /sick ]"))
    project.well("ship", "--hosts", "pi1")
    pi.exec("docker", "exec", running(pi)["tick"][0], "sh", "-c", ": > /sick")
    said = eventually(lambda: (found := project.fab("status", "--hosts", "pi1")).code and found, within=60)
    assert said
    assert "tick unhealthy" in said.out
