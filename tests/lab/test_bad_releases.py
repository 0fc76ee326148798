from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import HEAVY, LAB, Project, current, environment, running, service

if TYPE_CHECKING:
    from tests.lab.conftest import Lab, Pi

WRONG = f"{LAB}-wrong"
FAILS = service(more='command: [sh, -c, "echo looking for the camera; echo no camera: $$COLOUR; exit 3"]')
NEVER_HEALTHY = service(check="echo no lidar; false").replace("start_period: 20s", "start_period: 1s")


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        pytest.param(FAILS, "no camera: red", id="exits at once"),
        pytest.param(NEVER_HEALTHY, "unhealthy", id="never healthy"),
    ],
)
def test_a_release_that_does_not_run_is_taken_back(project: Project, pi: Pi, bad: str, says: str) -> None:
    """The person is told why, with the last log lines, and the previous release runs again."""
    project.colour("red")
    project.well("ship", "--hosts", "pi1")
    before = current(pi)
    project.stack(tick=bad)
    said = project.fab("ship", "--hosts", "pi1")
    assert said.code == 1
    assert says in said.out
    assert current(pi) == before
    assert running(pi)["tick"][1] == before
    assert project.well("status", "--hosts", "pi1", "--json").json["pi1"]["healthy"]
    assert [
        event["outcome"].partition(":")[0] for event in project.well("history", "--json").json["pi1"]
    ] == [
        "done",
        "failed",
    ]


def test_the_first_release_that_exits_at_once_is_stopped(project: Project, pi: Pi) -> None:
    """Nothing ran before: the failure is told, nothing is current, and it does not restart for ever."""
    project.stack(tick=FAILS)
    said = project.fab("ship", "--hosts", "pi1")
    assert said.code == 1
    assert "looking for the camera" in said.out
    assert current(pi) == ""
    assert pi.exec("docker", "ps", "--all", "--format", "{{.State}}") == "exited"
    project.stack(tick=service())
    project.well("ship", "--hosts", "pi1")


def test_one_bad_robot_does_not_hold_up_the_others(project: Project) -> None:
    """A value that only one robot chokes on: that one goes back, the others have the new release."""
    project.colour("red")
    project.well("ship")
    command = 'command: [sh, -c, "[ $$COLOUR = green ] && while :; do sleep 1; done; exit 3"]'
    project.stack(tick=service(more=command))
    project.inventory(
        everyone={"robots": ["*"], "environment": {"COLOUR": "green"}},
        second={"robots": ["pi2"], "environment": {"COLOUR": "mauve"}},
    )
    said = project.fab("ship", "--json")
    assert (said.code, said.status) == (1, {"pi1": "done", "pi2": "failed", "pi3": "done"})
    assert [environment(pi)["COLOUR"] for pi in project.lab.pis] == ["green", "red", "green"]


@pytest.mark.parametrize(
    ("compose", "says"),
    [
        ("name: tiny\nservices: [tick]\n", "services"),
        ("name: tiny\nservices:\n  tick: {build: .}\n", "image"),
        ("name: tiny\nservices:\n  tick: {image: a\n", "compose.yaml"),
        (None, "compose.yaml"),
    ],
    ids=["services is a list", "no image", "not YAML", "no file"],
)
def test_a_compose_file_that_cannot_be_read_is_the_persons_mistake(
    project: Project, compose: str | None, says: str
) -> None:
    """Refused on the desktop, with the file and the line: exit code 2."""
    path = project.directory / "docker" / "compose.yaml"
    path.unlink() if compose is None else path.write_text(compose)
    said = project.fab("ship", "--hosts", "pi1")
    assert (said.code, says in said.err) == (2, True), said


@pytest.mark.parametrize(
    ("more", "says"),
    [
        pytest.param("imagee: x", "imagee", id="unknown key"),
        pytest.param("ports: [80000:1]", "80000", id="impossible value"),
        pytest.param('labels: ["a=${MISSING:?is not set}"]', "MISSING", id="missing variable"),
        pytest.param("volumes: [nowhere:/data]", "nowhere", id="undefined volume"),
    ],
)
def test_a_compose_file_that_compose_refuses_touches_nothing(
    project: Project, pi: Pi, more: str, says: str
) -> None:
    """Compose judges it on the desktop: exit code 2, with file and line, before any robot is asked."""
    project.well("ship", "--hosts", "pi1")
    before = running(pi), current(pi)
    project.stack(tick=service(more=more))
    said = project.fab("ship", "--hosts", "pi1")
    assert (said.code, says in said.err, "compose.yaml:9: " in said.err) == (2, True, True), said
    assert (running(pi), current(pi)) == before


def test_an_image_for_another_processor_is_refused(project: Project, lab: Lab) -> None:
    """What its recorded platform says counts, before anything is sent: exit code 2, and no robot is looked at."""
    own = subprocess.run(
        ("docker", "inspect", "--format", "{{.Image}}", lab.pis[0].container),
        capture_output=True,
        text=True,
        check=True,
    )
    subprocess.run(("docker", "tag", own.stdout.strip(), WRONG), check=True)
    try:
        project.stack(tick=service(WRONG))
        said = project.fab("ship", "--hosts", "pi1")
    finally:
        subprocess.run(("docker", "rmi", WRONG), capture_output=True, check=True)
    assert said.code == 2
    assert f"{WRONG}:latest was built for linux/amd64, and the robot runs linux/arm64" in said.err


def test_an_image_that_is_not_here_is_refused(project: Project) -> None:
    """Exit code 2, and how to get it."""
    project.stack(tick=service(f"{LAB}-none"))
    said = project.fab("ship", "--hosts", "pi1")
    assert said.code == 2
    assert f"there is no image {LAB}-none for linux/arm64 here" in said.err
    assert "fab build" in said.err


def test_a_robot_without_docker_says_provision(project: Project, own_lab: Lab) -> None:
    """A blank Pi between two good ones: the person is told the verb, the others are done."""
    blank = own_lab.pis[0]
    inventory = own_lab.inventory
    inventory.write_text(inventory.read_text().replace("pi1: {", "blank: {"))
    project.inventory(also=inventory)
    project.well("trust", "--yes")
    said = project.fab("ship", "--json")
    assert said.status == {"pi1": "done", "pi2": "done", "pi3": "done", "blank": "failed"}
    (outcome,) = (o for o in said.json if o["robot"] == "blank")
    assert (outcome["reason"], outcome["cure"]) == (
        "Docker is not installed",
        "`fab provision --hosts blank`",
    )
    assert blank.ssh("ls -d .fleet").returncode != 0


def test_a_robot_whose_docker_is_stopped_says_so(project: Project, pi: Pi) -> None:
    """Nothing is sent; once Docker runs, the same command does it."""
    pi.exec("systemctl", "stop", "docker.socket", "docker")
    try:
        said = project.fab("ship", "--json")
    finally:
        pi.exec("systemctl", "start", "docker")
    assert (said.code, said.status) == (1, {"pi1": "failed", "pi2": "done", "pi3": "done"})
    assert said.json[0]["reason"] == "Docker is installed and not running"
    assert project.well("ship", "--json").status == {"pi1": "done", "pi2": "unchanged", "pi3": "unchanged"}


def test_a_robot_that_is_too_full_is_not_sent_anything(project: Project, pi: Pi) -> None:
    """The numbers are compared before the first byte; what runs there runs on."""
    project.well("ship", "--hosts", "pi1")
    before = running(pi)
    project.stack(tick=service(HEAVY))
    pi.exec("mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", "/var/lib/docker")
    try:
        said = project.fab("ship", "--hosts", "pi1", "--json")
    finally:
        pi.exec("umount", "/var/lib/docker")
    assert (said.code, said.json[0]["sent"]) == (1, 0)
    assert "of free disk, and has" in said.json[0]["reason"]
    assert running(pi) == before


def test_a_disk_that_fills_up_during_the_load(project: Project, pi: Pi) -> None:
    """The load fails half-way: that is said with its cure, the previous release runs on, and the next ship succeeds."""
    project.well("ship", "--hosts", "pi1")
    before = running(pi)
    project.stack(tick=service(HEAVY))
    pi.exec("mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", "/var/lib/docker/tmp")
    try:
        said = project.fab("ship", "--hosts", "pi1", "--json")
    finally:
        pi.exec("umount", "/var/lib/docker/tmp")
    (outcome,) = said.json
    assert (said.code, outcome["reason"].splitlines()[0]) == (1, "the robot's disk is full")
    assert "docker image prune" in outcome["cure"]
    assert running(pi) == before
    project.well("ship", "--hosts", "pi1")


def test_a_home_that_is_full(project: Project, pi: Pi) -> None:
    """The release cannot be written: nothing is half there, and what runs is not disturbed."""
    project.well("ship", "--hosts", "pi1")
    before = running(pi), current(pi)
    project.colour("green")
    pi.exec("sh", "-c", "mount -t tmpfs -o size=64k,uid=1000 tmpfs ~pi/.fleet/stacks/tiny/releases")
    try:
        pi.exec("sh", "-c", "head -c 64k /dev/zero > ~pi/.fleet/stacks/tiny/releases/fill || true")
        said = project.fab("ship", "--hosts", "pi1", "--json")
    finally:
        pi.exec("sh", "-c", "umount ~pi/.fleet/stacks/tiny/releases")
    assert (said.code, said.json[0]["reason"].splitlines()[0]) == (1, "the robot's disk is full")
    assert (running(pi), current(pi)) == before


def test_a_login_that_talks_and_sets_variables(project: Project, pi: Pi) -> None:
    """What ~/.bashrc prints corrupts nothing, and variables of the robot's own do not leak into the release."""
    leaks = "ROS_MASTER_URI=http://wrong:1 COLOUR=wrong FLEET_ROBOT=wrong COMPOSE_PROJECT_NAME=wrong COMPOSE_FILE=/wrong.yaml"
    script = (
        "cp ~pi/.bashrc /root/bashrc; cp /etc/environment /root/environment 2>/dev/null || : > /root/environment"
        f"; printf '%s\\n' 'echo Welcome; echo Warning >&2' 'export {leaks}' | cat - /root/bashrc > ~pi/.bashrc"
        f"; printf '%s\\n' {leaks} ROS_HOSTNAME=wrong >> /etc/environment"
    )
    project.stack(tick=service().replace("[COLOUR", "[ROS_MASTER_URI, ROS_HOSTNAME, COLOUR"))
    project.colour("right")
    pi.exec("sh", "-c", script)
    try:
        assert b"Welcome" in pi.ssh("true").stdout
        project.well("ship", "--hosts", "pi1")
        found = environment(pi)
        assert project.well("ship", "--hosts", "pi1", "--json").status == {"pi1": "unchanged"}
        assert project.well("status", "--hosts", "pi1", "--json").json["pi1"]["healthy"]
        assert "pi1 | tick" in project.well("logs", "--hosts", "pi1").out
    finally:
        pi.exec("sh", "-c", "cat /root/bashrc > ~pi/.bashrc; cp /root/environment /etc/environment")
    assert "wrong" not in " ".join(found.values()), found
    assert (found["COLOUR"], found["FLEET_ROBOT"], found["ROS_HOSTNAME"]) == ("right", "pi1", pi.address)
