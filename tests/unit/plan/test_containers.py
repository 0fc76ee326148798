from __future__ import annotations

import os
import signal
import subprocess
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.errors import NotReady
from fleet.plan import compose_steps, containers
from fleet.plan.compose_steps import Request
from fleet.plan.step import Plan
from tests.support.samples import PI, change, container, facts

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.plan.containers import Verb
    from fleet.robot.facts import Container, Facts

REQUEST = Request(by="tim@desktop", run="run")
WELL = container("abc")
ILL = container("abc", health="unhealthy")
GONE = container("abc", state="exited")
OTHER = container("old")


def robot_with(*containers: Container, **values: object) -> Facts:
    return facts(current="abc", releases=("abc",), containers=containers, services=("talker",), **values)


def planned(verb: Verb, seen: Facts) -> Plan:
    return containers.plan(verb, robot=PI, stack="talker", facts=seen, request=REQUEST)


@pytest.mark.parametrize(
    ("verb", "has"),
    [
        ("start", (GONE,)),
        ("start", ()),
        ("start", (ILL,)),
        ("start", (WELL, GONE)),
        ("start", (OTHER,)),
        ("stop", (WELL,)),
        ("stop", (ILL, GONE)),
        ("stop", (OTHER,)),
        ("stop", (container("abc", state="restarting"),)),
        ("restart", (WELL,)),
        ("restart", (GONE,)),
        ("restart", ()),
    ],
)
def test_what_each_verb_does(verb: Verb, has: tuple[Container, ...]) -> None:
    """Each is one swap, which the robot does by itself."""
    assert planned(verb, robot_with(*has)) == Plan(
        robot="pi1",
        summary=f"{verb} release abc",
        verb=verb,
        steps=(compose_steps.swap(verb, "talker", "abc", seen="abc", request=REQUEST),),
    )


@pytest.mark.parametrize(
    ("verb", "has", "summary"),
    [
        ("start", (WELL,), "release abc runs"),
        ("start", (WELL, replace(WELL, health="")), "release abc runs"),
        (
            "start",
            (WELL, container("abc", service="x", state="exited", code=0, policy="no")),
            "release abc runs",
        ),
        ("stop", (GONE,), "release abc is stopped"),
        ("stop", (), "release abc is stopped"),
    ],
)
def test_what_is_so_already_is_left_alone(verb: Verb, has: tuple[Container, ...], summary: str) -> None:
    """The second of the same command does nothing."""
    assert planned(verb, robot_with(*has)) == Plan(robot="pi1", summary=summary)


def test_a_stack_is_taken_off() -> None:
    """Its data stays; a second time there is nothing to do."""
    plan = containers.remove(robot=PI, stack="talker", facts=robot_with(WELL), by="tim@desktop")
    assert plan.steps == (compose_steps.remove("talker", by="tim@desktop"),)
    again = containers.remove(robot=PI, stack="talker", facts=facts(), by="tim@desktop")
    assert again == Plan(robot="pi1", summary="has no stack talker")


def test_data_is_deleted_only_if_that_was_asked() -> None:
    """After the containers that use it, in the same plan; by root if the login may, as containers write as anybody."""
    plan = containers.remove(
        robot=PI, stack="talker", facts=robot_with(WELL, data=5), by="tim@desktop", data=True
    )
    off, delete = plan.steps
    assert off == compose_steps.remove("talker", by="tim@desktop")
    assert delete.argv[:5] == ("sudo", "-n", "rm", "-rf", "--one-file-system")
    assert delete.argv[5] == "/home/pi/.fleet/stacks/talker/data"
    none = containers.remove(robot=PI, stack="talker", facts=facts(data=0), by="tim@desktop", data=True)
    assert none == Plan(robot="pi1", summary="has no data of stack talker")


def test_a_swap_that_was_interrupted_is_finished() -> None:
    """A journal says that somebody's command did not come to its end."""
    assert planned("start", robot_with(WELL, journal="swap ship x")).steps


@pytest.mark.parametrize("verb", ["start", "stop", "restart"])
@pytest.mark.parametrize("seen", [facts(), facts(current="abc", releases=("old",))])
def test_nothing_to_start_or_stop(verb: Verb, seen: Facts) -> None:
    """Nothing was shipped, or the current release was removed by hand."""
    with pytest.raises(NotReady) as caught:
        planned(verb, seen)
    assert (caught.value.what, caught.value.cure) == (
        "nothing has been shipped to it",
        "`fab ship --hosts pi1`",
    )


@pytest.mark.parametrize("verb", ["start", "stop", "restart"])
def test_no_docker_is_told_before_anything_else(verb: Verb) -> None:
    """As for ship."""
    with pytest.raises(NotReady, match="Docker is not installed"):
        planned(verb, change(robot_with(WELL), docker_state="absent"))


def logs(
    seen: Facts, *, follow: bool = False, tail: str = "20", since: str = "", service: str = ""
) -> tuple[str, ...]:
    argv = containers.logs(
        robot=PI, stack="talker", facts=seen, follow=follow, tail=tail, since=since, service=service
    )
    return argv[argv.index("compose") :]


ONE = robot_with(WELL)
TWO = robot_with(WELL, container("abc", service="camera"))


def test_the_logs_of_one_service_need_no_names_and_those_of_two_do() -> None:
    """The robot's name stands before each line already."""
    assert logs(ONE) == ("compose", "logs", "--no-color", "--tail", "20", "--no-log-prefix")
    assert logs(TWO) == ("compose", "logs", "--no-color", "--tail", "20")
    assert logs(TWO, service="camera") == (
        *("compose", "logs", "--no-color", "--tail", "20", "--no-log-prefix"),
        "camera",
    )


def test_how_much_of_the_logs() -> None:
    """What the person said goes to Compose as it is."""
    assert logs(ONE, tail="all", since="10m")[3:] == ("--tail", "all", "--no-log-prefix", "--since", "10m")


def test_logs_of_a_robot_without_a_release() -> None:
    """There are none."""
    with pytest.raises(NotReady, match="nothing has been shipped to it"):
        logs(facts())


def follower(command: tuple[str, ...]) -> subprocess.Popen[bytes]:
    """What follows logs on a robot, with another command in the place of Compose."""
    argv = containers.logs(robot=PI, stack="talker", facts=ONE, follow=True, tail="1", since="", service="")
    assert argv[argv.index("compose") :][-1] == "--follow"
    start = argv[: argv.index("env")]
    return subprocess.Popen((*start, *command), stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def test_a_follower_ends_with_its_connection(tmp_path: Path) -> None:
    """Without a terminal nothing else would end it: one more process on the robot for every `fab logs --follow`."""
    pid = tmp_path / "pid"
    script = f"echo $$ > {pid}; echo one; while :; do read -r x < {tmp_path / 'never'}; done"
    os.mkfifo(tmp_path / "never")
    process = follower(("sh", "-c", script))
    assert process.stdout
    assert process.stdin
    assert process.stdout.readline() == b"one\n"
    followed = int(pid.read_text())
    os.kill(followed, 0)
    process.stdin.close()
    process.wait(timeout=10)
    assert process.stdout.read() == b""  # comes only when the last holder of it has ended
    process.stdout.close()
    with pytest.raises(ProcessLookupError):
        _until_gone(followed)


@pytest.mark.parametrize("code", [0, 3])
def test_a_follower_ends_with_what_it_follows(code: int) -> None:
    """Docker was stopped on the robot: it is told, with its exit code, though nobody closed the connection."""
    process = follower(("sh", "-c", f"echo one; exit {code}"))
    assert process.stdout
    assert process.stdin
    assert process.wait(timeout=10) == code
    assert process.stdout.read() == b"one\n"
    process.stdin.close()
    process.stdout.close()


def _until_gone(pid: int) -> None:
    for _ in range(500):
        os.kill(pid, 0)
        time.sleep(0.01)
    os.kill(pid, signal.SIGKILL)


def test_a_stack_of_systemd_is_stopped_even_if_it_has_ended() -> None:
    """Else systemd would start it again; the second time it is unchanged."""
    ended = container("abc", state="exited")
    there = facts(current="abc", releases=("abc",), containers=(ended,), boot="systemd")

    def stops(seen: Facts) -> bool:
        return bool(containers.plan("stop", robot=PI, stack="talker", facts=seen, request=REQUEST).steps)

    assert stops(there)
    assert not stops(change(there, stopped=True))
    assert not stops(change(there, boot="docker"))
