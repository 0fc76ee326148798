from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import TINY, current, environment, eventually, running, service

if TYPE_CHECKING:
    from tests.lab.conftest import Pi
    from tests.support.lab_project import Project

ALL = ("pi1", "pi2", "pi3")

NASTY = {
    "SPACES": " two  spaces ",
    "QUOTES": """it's "quoted" and `ticked`""",
    "SINGLE": "'",
    "DOUBLE": '"',
    "BACKSLASH": "\\",
    "BACKSLASHES": r"""C:\new\table\\ \' \" \$HOME \n end\\""",
    "QUOTED_BACKSLASHES": r"it's C:\new\table\\ \$HOME \" \\' end\\",
    "SHELL": "$(touch /tmp/owned) `touch /tmp/owned` $HOME ${HOME} ${HOME:-x} $$ $; touch /tmp/owned & | > <",
    "QUOTED_SHELL": "'$(touch /tmp/owned)' ${HOME} $$",
    "LINES": "one\ntwo = 2\n\n  '$HOME' # five\nEND\n",
    "CARRIAGE_RETURNS": "a\rb\r\nc\r",
    "TABS": "\ttab\t",
    "HASH": "a #no comment",
    "HASH_FIRST": "#no comment",
    "EQUALS": "=a=b==c",
    "BRACES": "{{.}} {a: b} [c] %s %(x)s !tag &anchor *alias",
    "UNICODE": "Grüße, ロボット 🤖",
    "EMPTY": "",
    "NULL": "null",
    "NUMBER": "0123",
}
"""What people put into values, and what shells, YAML and `.env` files make of it when somebody forgets to quote."""


def test_a_second_ship_changes_nothing(project: Project) -> None:
    """The same command twice: no byte is sent, and no container is touched."""
    first = project.well("ship", "--json")
    before = [running(pi) for pi in project.lab.pis]
    again = project.well("ship", "--json")
    assert first.status == dict.fromkeys(ALL, "done")
    assert again.status == dict.fromkeys(ALL, "unchanged")
    assert [outcome["sent"] for outcome in again.json] == [0, 0, 0]
    assert [running(pi) for pi in project.lab.pis] == before
    assert [current(pi) for pi in project.lab.pis] == [found["tick"][1] for found in before]


def test_a_robot_that_is_off_holds_up_nobody(project: Project) -> None:
    """Two done, one unreachable, exit code 1; once it is on, the same command finishes it and leaves the others alone."""
    *on, off = project.lab.pis
    subprocess.run(("docker", "stop", off.container), capture_output=True, check=True)
    try:
        said = project.fab("ship", "--json")
        before = [running(pi) for pi in on]
    finally:
        subprocess.run(("docker", "start", off.container), capture_output=True, check=True)
    assert (said.code, said.status) == (1, {"pi1": "done", "pi2": "done", "pi3": "unreachable"})
    assert eventually(lambda: off.ssh("docker version").returncode == 0)
    assert project.well("ship", "--json").status == {"pi1": "unchanged", "pi2": "unchanged", "pi3": "done"}
    assert [running(pi) for pi in on] == before


def test_only_the_robot_that_differs_is_touched(project: Project) -> None:
    """One robot's value changes: the others' containers run on."""
    project.well("ship")
    one, *others = project.lab.pis
    before = [running(pi) for pi in others]
    project.inventory(first={"robots": ["pi1"], "environment": {"COLOUR": "red"}})
    said = project.well("ship", "--json")
    assert said.status == {"pi1": "done", "pi2": "unchanged", "pi3": "unchanged"}
    assert environment(one)["COLOUR"] == "red"
    assert [running(pi) for pi in others] == before


def test_a_stack_of_two_services(project: Project, pi: Pi) -> None:
    """Each runs, each has the robot's values, `--service` shows one; one that leaves the stack leaves the robot."""
    project.stack(
        tick=service(), tock=service(more='command: [sh, -c, "echo tock $$FLEET_ROBOT; sleep 1000"]')
    )
    project.well("ship", "--hosts", "pi1")
    assert sorted(running(pi)) == ["tick", "tock"]
    assert environment(pi, "tock")["FLEET_ROBOT"] == "pi1"
    assert project.well("logs", "--hosts", "pi1", "--service", "tock").out == "pi1 | tock pi1\n"
    project.stack(tick=service())
    project.well("ship", "--hosts", "pi1")
    assert list(running(pi)) == ["tick"]


def test_values_arrive_as_they_were_written(project: Project, pi: Pi) -> None:
    """Neither the inventory, SSH, the shell, `.env` nor Compose changes a character or runs one."""
    copies = {f"{name}_COPY": f"${{{name}}}" for name in NASTY}
    project.stack(
        tick=service().replace(
            "[COLOUR, FLEET_ROBOT]", str([*NASTY, *(f"{k}={v}" for k, v in copies.items())])
        )
    )
    project.inventory(first={"robots": ["pi1"], "environment": NASTY})
    project.well("ship", "--hosts", "pi1")
    found = environment(pi)
    assert {name: found.get(name) for name in NASTY} == NASTY
    assert {name: found.get(f"{name}_COPY") for name in NASTY} == NASTY
    assert pi.exec("sh", "-c", "ls /tmp/owned ~pi/owned 2>/dev/null || true") == ""


def test_files_are_mounted_as_they_are(project: Project, pi: Pi) -> None:
    """Each robot's own, byte by byte; a changed file is another release, and the container sees the new one."""
    project.stack(tick=service(more='volumes: ["./files:/etc/tiny:ro"]'))
    project.inventory(first={"robots": ["pi1"], "files": {"camera/über $x.bin": "config/camera"}})
    config = project.write("config/camera", "")
    for content in (bytes(range(256)), b"another\r\n"):
        config.write_bytes(content)
        project.well("ship", "--hosts", "pi1")
        inner = ("docker", "exec", running(pi)["tick"][0], "cat", "/etc/tiny/camera/über $x.bin")
        assert (
            subprocess.run(("docker", "exec", pi.container, *inner), capture_output=True, check=True).stdout
            == content
        )


def test_rollback_goes_back_and_the_history_tells(project: Project) -> None:
    """The release that ran before runs again on every robot, from its own directory; once more goes forward again."""
    releases = []
    for colour in ("red", "green"):
        project.colour(colour)
        project.well("ship")
        releases.append(current(project.lab.pis[0]))
    assert project.well("rollback", "--json").status == dict.fromkeys(ALL, "done")
    assert [environment(pi)["COLOUR"] for pi in project.lab.pis] == ["red", "red", "red"]
    assert current(project.lab.pis[0]) == releases[0]
    assert project.well("rollback", "--to", releases[0], "--hosts", "pi1", "--json").status == {
        "pi1": "unchanged"
    }
    told = project.well("history", "--json").json
    assert [(event["verb"], event["release"], event["outcome"]) for event in told["pi1"]] == [
        ("ship", releases[0], "done"),
        ("ship", releases[1], "done"),
        ("rollback", releases[0], "done"),
    ]


def test_a_release_works_by_hand_on_the_robot(project: Project, pi: Pi) -> None:
    """`docker compose up` in its directory finds everything there, and nothing to change."""
    project.well("ship", "--hosts", "pi1")
    before = running(pi)
    done = pi.ssh("cd ~/.fleet/stacks/tiny/current && docker compose up --detach --pull never")
    assert done.returncode == 0, done.stderr
    assert running(pi) == before


@pytest.mark.parametrize(
    "damages",
    [
        pytest.param(
            ("docker rm --force $(docker ps --quiet)", "docker stop $(docker ps --quiet)", "rm -r .fleet"),
            id="container removed, container stopped, all files removed",
        ),
        pytest.param(
            (
                "cd .fleet/stacks/tiny/current && echo broken > .env && rm compose.yaml",
                "rm -r .fleet/stacks/tiny/releases/*",
                "ln -sfn releases/none .fleet/stacks/tiny/current",
            ),
            id="release damaged, releases removed, current leads nowhere",
        ),
        pytest.param(
            (f"docker rm -f $(docker ps -q) && docker image rm --force $(docker image ls --quiet {TINY})",)
            * 3,
            id="image removed",
        ),
    ],
)
def test_the_next_ship_mends_what_was_damaged(project: Project, damages: tuple[str, str, str]) -> None:
    """Whatever somebody did by hand on the robots, the same command brings the release back, and then is content."""
    project.well("ship")
    pis = project.lab.pis
    releases = [current(pi) for pi in pis]
    for pi, damage in zip(pis, damages, strict=True):
        done = pi.ssh(damage)
        assert done.returncode == 0, (damage, done.stderr)
    assert project.well("ship", "--json").status == dict.fromkeys(ALL, "done")
    assert [current(pi) for pi in pis] == releases
    assert [running(pi)["tick"][1] for pi in pis] == releases
    for check in (pi.ssh("cd ~/.fleet/stacks/tiny/current && docker compose config --quiet") for pi in pis):
        assert check.returncode == 0, check.stderr
    assert project.well("ship", "--json").status == dict.fromkeys(ALL, "unchanged")


def test_two_desktops_at_once_do_no_harm(project: Project, pi: Pi) -> None:
    """Both ship the same release: whatever each is told, it runs afterwards, and a ship then is content."""
    with project.start("ship", "--hosts", "pi1") as one, project.start("ship", "--hosts", "pi1") as two:
        both = (one.end(), two.end())
    assert "Traceback" not in both[0].all + both[1].all
    assert 0 in {said.code for said in both}, both
    project.well("ship", "--hosts", "pi1")
    assert running(pi)["tick"][1] == current(pi)
    assert pi.exec("sh", "-c", "ls ~pi/.fleet/stacks/tiny/releases") == current(pi)


def test_it_works_from_a_folder_of_the_project(project: Project) -> None:
    """Paths of the inventory are relative to it, not to where the person happens to be."""
    with project.start("ship", "--hosts", "pi1", "--json", cwd=project.directory / "docker") as fab:
        assert fab.end().code == 0


def test_fabrics_own_hosts_flag_is_refused(project: Project) -> None:
    """Before the task `-H` would act on every robot: exit code 2, the right spelling, and nothing was touched."""
    for line in (("-H", "pi1", "ship"), ("--hosts", "pi1", "ship"), ("ship", "-H", "pi1")):
        said = project.fab(*line)
        assert said.code == 2, (line, said)
        assert "fab ship --hosts pi1" in said.err
    assert [running(pi) for pi in project.lab.pis] == [{}, {}, {}]


def test_an_unknown_robot_is_the_persons_mistake(project: Project) -> None:
    """Exit code 2, and what was meant."""
    said = project.fab("ship", "--hosts", "pi1,p2")
    assert said.code == 2
    assert "pi2" in said.err
