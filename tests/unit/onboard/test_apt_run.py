from __future__ import annotations

import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet.provision import apt
from fleet.robot.facts import Facts, Login

if TYPE_CHECKING:
    from pathlib import Path

ROOT = Facts(login=Login(sudo="root"))


def run(
    *argv: str, lock_timeout: int = 20, limit: int = 20, pause: int = 5
) -> subprocess.CompletedProcess[str]:
    """The very argv of the step, run by the desktop's own shell: apt itself is not needed for it."""
    step = apt.run(
        "x", argv, facts=ROOT, bounds=apt.Bounds(lock_timeout=lock_timeout, limit=limit, pause=pause)
    )
    return subprocess.run(step.argv, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize("code", [0, 1, 100])
def test_output_and_exit_code_come_through(code: int) -> None:
    """Also of a command that ends at once, before anybody listens."""
    for _ in range(10):
        done = run("sh", "-c", f"echo one; echo two >&2; exit {code}")
        assert (done.returncode, done.stdout, done.stderr) == (code, "one\ntwo\n", "")


def test_arguments_stay_whole() -> None:
    """Spaces, quotes and dollars are only text."""
    assert run("printf", "%s|", "a b", "'\"", "$(date)", "*").stdout == "a b|'\"|$(date)|*|"


def test_apt_is_told_to_wait_for_dpkgs_locks() -> None:
    """By a configuration of its own, which reaches the apt that a script runs."""
    assert 'DPkg::Lock::Timeout "7"' in run("sh", "-c", 'cat "$APT_CONFIG"', lock_timeout=7).stdout


def test_a_command_that_does_not_end_is_ended() -> None:
    """Also one that ignores the first request, with all that it started; the sentence says so."""
    started = time.monotonic()
    done = run("sh", "-c", "trap '' TERM; sleep 5432 & while :; do sleep 5432; done", limit=1)
    assert (done.returncode, done.stdout) == (1, "the command did not end within 1 s, and was stopped\n")
    assert time.monotonic() - started < 15
    assert subprocess.run(("pgrep", "-f", "[s]leep 5432"), capture_output=True, check=False).returncode == 1


@pytest.mark.parametrize(
    "message",
    [
        "E: Could not get lock /var/lib/apt/lists/lock. It is held by process 12 (apt-get)",
        "dpkg: error: dpkg frontend lock was locked by /usr/bin/dpkg process with pid 12",
        "dpkg: error: dpkg frontend lock was locked by another process with pid 12",
    ],
)
def test_while_apt_is_locked_it_is_tried_again(message: str, tmp_path: object) -> None:
    """The lock of the package lists is the one that apt does not wait for."""
    script = f'[ -e "$0" ] && exit 0; touch "$0"; echo "{message}" >&2; exit 100'
    started = time.monotonic()
    done = run("sh", "-c", script, f"{tmp_path}/tried", pause=1)
    assert (done.returncode, done.stdout) == (
        0,
        f"{message}\nanother program uses apt; trying again in 1 s\n",
    )
    assert time.monotonic() - started > 1


def test_a_lock_that_stays_is_the_end() -> None:
    """The waiting time is bounded, and the last output is apt's."""
    done = run(
        "sh", "-c", "echo 'E: Could not get lock /x. It is held by process 1 (y)'; exit 100", lock_timeout=0
    )
    assert (done.returncode, done.stdout.count("Could not get lock")) == (100, 1)


def test_another_failure_is_not_tried_again() -> None:
    """It would only fail again."""
    assert run("sh", "-c", "echo no; exit 3").stdout == "no\n"


def test_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The script keeps apt's configuration and output in a temporary folder, whose path may contain blanks."""
    folder = tmp_path / "a b"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    assert "Lock::Timeout" in run("sh", "-c", 'cat "$APT_CONFIG"').stdout
    assert list(folder.iterdir()) == []
