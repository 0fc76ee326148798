from __future__ import annotations

import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet.diagnosis import explain

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("output", "last"),
    [
        ("", ""),
        ("\n \n", ""),
        ("first\nthe reason.\n\n", "the reason"),
        ("the reason\n+ sh -c apt-get update\nW: a warning\nSee 'docker run --help'.\n", "the reason"),
        ("the reason\nsudo: unable to resolve host pi1: Name or service not known", "the reason"),
        ("W: only a warning", "W: only a warning"),
        ("\x1b[31mred\x1b[0m\trobot", "[31mred [0m robot"),
    ],
)
def test_unknown_output_ends_in_its_own_last_words(output: str, last: str) -> None:
    """What is not known is not guessed; noise is left out where there is more."""
    assert explain.explain(output) == (last, "")


def test_long_lines_are_cut() -> None:
    """A person reads a sentence, not a page."""
    what, _ = explain.explain("x" * 5000)
    assert (len(what), what[-1]) == (300, "…")


def test_braces_in_output_are_only_text() -> None:
    """Values from a robot never become a format."""
    assert explain.explain("yaml: line 2: {0.__class__}")[0].endswith("{0.__class__}")


@pytest.mark.parametrize(
    "word", ["unknown flag: ", "memory cgroup ", "services.", "iptables ", "x", "Bind for ", "sh: "]
)
def test_endless_output_is_read_quickly(word: str) -> None:
    """A verbose tool prints a megabyte, in one line."""
    started = time.process_time()
    explain.explain(word * (1_000_000 // len(word)))
    assert time.process_time() - started < 5


def test_real_shells_are_understood(tmp_path: Path) -> None:
    """The desktop's own tools, run."""
    for argv in (
        ("sh", "-c", "nosuchcommand"),
        ("bash", "-c", "nosuchcommand"),
        ("timeout", "5", "nosuchcommand"),
    ):
        done = subprocess.run(
            argv,
            capture_output=True,
            text=True,
            check=False,
            env={"LC_ALL": "C", "PATH": "/usr/bin:/bin"},
            cwd=tmp_path,
        )
        what, cure = explain.explain(done.stderr, code=done.returncode)
        assert what == "the command nosuchcommand is missing on the robot"
        assert "apt-cache search nosuchcommand" in cure


def test_a_missing_command_is_known_by_its_exit_code() -> None:
    """A shell says it in the robot's language."""
    said = "bash: Zeile 1: flock: Kommando nicht gefunden."
    assert explain.explain(said, code=127) == (
        f"a command is missing on the robot ({said.removesuffix('.')})",
        "install the package that has it on the robot",
    )
    assert explain.explain(said, code=1)[1] == ""
    assert explain.explain("", code=127)[0] == "a command is missing on the robot (exit code 127)"


def test_a_program_that_is_missing_may_be_missing_in_a_container() -> None:
    """What a container prints is shown when it does not start."""
    said = "talker has ended with code 127\nbash: line 1: xz: command not found"
    assert "install xz-utils in its image" in explain.explain(said, verb="ship")[1]
    assert explain.explain(said)[1] == "`sudo apt-get install xz-utils` on the robot"


JOURNAL = (
    "unable to configure the Docker daemon with file /etc/docker/daemon.json: the following directives don't match any"
    " configuration option: log-opt"
)
JOB = "Job for docker.service failed because the control process exited with error code."


def test_what_the_robot_is_asked_afterwards_is_diagnosed_too() -> None:
    """The reason stands in the journal, and its cure is the one that is told."""
    what, cure = explain.explain(JOB, verb="provision", details=JOURNAL)
    assert what == (
        "Docker does not start: Docker rejects its configuration: the following directives don't match any configuration"
        " option: log-opt"
    )
    assert cure == "fix /etc/docker/daemon.json on the robot, then run the same command again"


def test_details_count_only_if_the_error_itself_has_no_cause() -> None:
    """An old journal may tell of another trouble; an error that nobody knows is told with what is known of it."""
    locked = "E: Could not get lock /var/lib/dpkg/lock"
    assert explain.explain(locked, details=JOURNAL) == explain.explain(locked)
    assert explain.explain("some trouble", details="nothing that is known") == ("some trouble", "")
    what, cure = explain.explain("some trouble", details=JOURNAL)
    assert what.startswith("some trouble: Docker rejects its configuration")
    assert "daemon.json" in cure
    started = "failed to start daemon: no such driver"
    assert explain.explain(JOB, details=started)[0] == "Docker does not start: no such driver"
