from __future__ import annotations

import pytest

from fleet import onboard
from fleet.config.watch import Hook
from fleet.errors import NotReady
from fleet.plan import compose_steps, dev_steps
from fleet.plan.compose_steps import Request
from fleet.plan.step import Plan
from fleet.robot.facts import Dev
from tests.support.samples import PI, container, facts

REQUEST = Request(by="tim@desktop", run="5f", wait=200, settle=7)
DEV = Dev(by="ada@laptop", since="2026-11-28T12:00:00Z")


def test_the_stack_is_held_while_the_connection_lasts() -> None:
    """With the scripts that bring the release back at the next boot."""
    argv = dev_steps.hold("talker", "abc", session="5e55", request=REQUEST)
    assert argv[:4] == ("sh", "-c", onboard.text("until_closed.sh"), "until_closed")
    scripts = (onboard.text("detach.sh"), onboard.text("swap.sh"))
    assert argv[4:] == (
        *("sh", "-c", onboard.text("dev_hold.sh"), "dev_hold"),
        *("talker", "abc", "tim@desktop", "5e55", *scripts, "200", "7"),
    )


def test_an_upload_is_taken_from_where_it_was_cut() -> None:
    """All numbers are arguments."""
    argv = dev_steps.sync("talker", session="5e55", name="0a", size=12, offset=5, restart=("node", "web"))
    assert argv[4:] == ("talker", "5e55", "0a", "12", "5", "node", "web")


def test_a_command_in_a_container() -> None:
    """With the words of `exec:`; no shell is in between."""
    hook = Hook(
        command=("kill", "-HUP", "1"), user="root", folder="/", privileged=True, environment=(("A", "b c"),)
    )
    argv = dev_steps.hook("talker", "abc", "node", hook)
    options = ("--user", "root", "--workdir", "/", "--privileged", "--env", "A=b c")
    assert argv == compose_steps.compose("talker", "abc", "exec", "-T", *options, "node", "kill", "-HUP", "1")


def test_log_lines_from_now_on() -> None:
    """They end with the connection."""
    options = ("logs", "--follow", "--no-color", "--no-log-prefix", "--since", "1790000000")
    assert dev_steps.logs("talker", "abc", since="1790000000")[-6:] == options


def test_the_end_of_dev_is_a_swap_to_the_same_release() -> None:
    """The robot does it by itself, watches the containers, and writes it into its history."""
    seen = facts(current="abc", releases=("abc",), containers=(container("abc"),), dev=DEV)
    assert dev_steps.end(robot=PI, stack="talker", facts=seen, request=REQUEST) == Plan(
        robot="pi1",
        summary="back at release abc",
        verb="dev",
        steps=(compose_steps.swap("dev", "talker", "abc", seen="abc", request=REQUEST),),
    )


def test_a_robot_that_is_not_in_dev_stays_as_it_is() -> None:
    """It says what it runs."""
    seen = facts(current="abc", releases=("abc",))
    assert dev_steps.end(robot=PI, stack="talker", facts=seen, request=REQUEST).summary == "runs release abc"
    assert (
        dev_steps.end(robot=PI, stack="talker", facts=facts(), request=REQUEST).summary == "nothing is in dev"
    )


def test_a_robot_without_docker_is_refused() -> None:
    """As by every verb."""
    with pytest.raises(NotReady):
        dev_steps.end(robot=PI, stack="talker", facts=facts(docker_state="absent"), request=REQUEST)
