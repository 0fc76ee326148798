from __future__ import annotations

import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.plan import compose_steps
from fleet.plan.compose_steps import Request, Verb
from fleet.plan.step import Record
from fleet.robot import paths
from tests.support.samples import release

if TYPE_CHECKING:
    from pathlib import Path

REQUEST = Request(by="tim@desktop", run="5f", wait=200, settle=7, conflict="desktop")


def test_compose_runs_in_the_release_and_heeds_nothing_of_the_login(tmp_path: Path) -> None:
    """The argv works with the ``env`` of Debian: a login's COMPOSE_FILE must not choose another stack."""
    folder = tmp_path / paths.folder("talker", "abc")
    folder.mkdir(parents=True)
    argv = compose_steps.compose("talker", "abc")
    assert argv[-2:] == ("docker", "compose")
    environment = {"PATH": os.environ["PATH"], "COMPOSE_FILE": "/x", "COMPOSE_PROFILES": "y", "OTHER": "kept"}
    script = "pwd; echo ${COMPOSE_FILE-unset} ${COMPOSE_PROFILES-unset} ${OTHER-unset}"
    done = subprocess.run(
        (*argv[:-2], "sh", "-c", script),
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"{folder}\nunset unset kept\n"


@pytest.mark.parametrize(
    ("verb", "title"),
    [("ship", "start release abc of talker"), ("rollback", "start release abc of talker")]
    + [(verb, f"{verb} release abc of talker") for verb in ("start", "stop", "restart")],
)
def test_a_swap_goes_on_without_the_desktop(verb: Verb, title: str) -> None:
    """Whoever comes back with the same token sees how it ends; both scripts get all that they need as arguments."""
    step = compose_steps.swap(verb, "talker", "abc", seen="def", request=REQUEST)
    assert (step.title, step.detached, step.resumes, step.harmless) == (title, True, True, False)
    assert step.argv == (
        *("sh", "-c", onboard.text("detach.sh"), "detach", "5f.talker"),
        *(
            onboard.text("swap.sh"),
            "swap",
            verb,
            "talker",
            "abc",
            "def",
            "tim@desktop",
            "200",
            "7",
            "desktop",
        ),
    )


def test_a_swap_has_time_for_its_turn_the_release_and_the_way_back() -> None:
    """The desktop gives up after the robot: `onboard/swap.sh` bounds each of these itself."""
    step = compose_steps.swap("ship", "talker", "abc", seen="", request=REQUEST)
    assert step.limit is not None
    assert step.limit > compose_steps.TURN + 2 * (200 + 7 + 120)
    assert f"FLEET_TURN:-{compose_steps.TURN}" in onboard.text("swap.sh")


def test_the_release_is_written_for_the_home_of_the_login() -> None:
    """Its paths are absolute, so that it works for root by hand too."""
    step = compose_steps.write(release(), home="/home/robi")
    assert step.argv[-1] == f".fleet/stacks/talker/releases/{release().id}"
    assert step.feed is not None
    assert step.feed.label == f"{len(release().files('/home/robi'))} files"


def test_adopting_and_removing_name_the_stack() -> None:
    """And who removed it: the robot's history says so."""
    assert compose_steps.adopt("talker").argv[-1] == "talker"
    assert compose_steps.remove("talker", by="tim@desktop").argv[-2:] == ("talker", "tim@desktop")


def test_a_note_is_one_line_of_history() -> None:
    """For what is done to the robot as a whole."""
    record = Record(verb="provision", release="", by="tim@desktop")
    step = compose_steps.note(record, when="2026-11-23T12:00:00Z", outcome="done")
    assert step.argv[-1] == "2026-11-23T12:00:00Z\tprovision\t\ttim@desktop\tdone"
