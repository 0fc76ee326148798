from __future__ import annotations

import os
import signal
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from tests.support.lab_project import eventually

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class Attendants:
    """Desktops that run a script through `detach.sh` on a robot whose home is ``home``."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self._all: list[subprocess.Popen[str]] = []

    def attend(self, script: str, *arguments: str, run_name: str = "run.1") -> subprocess.Popen[str]:
        argv = ("sh", "-c", onboard.text("detach.sh"), "detach", run_name, script, "script", *arguments)
        environment = {"PATH": f"{self.home.parent / 'bin'}:{os.environ['PATH']}", "HOME": str(self.home)}
        one = subprocess.Popen(
            argv,
            cwd=self.home,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._all.append(one)
        return one

    def ended(self, one: subprocess.Popen[str]) -> tuple[int, str, str]:
        out, errors = one.communicate(timeout=20)
        return one.returncode, out, errors

    def run(self, script: str, *arguments: str, run_name: str = "run.1") -> tuple[int, str, str]:
        return self.ended(self.attend(script, *arguments, run_name=run_name))

    @property
    def runs(self) -> Path:
        return self.home / ".fleet/runs"

    def clear(self) -> None:
        for one in self._all:
            if one.poll() is None:
                one.kill()
            one.communicate()


@pytest.fixture
def robot(home: Path) -> Iterator[Attendants]:
    made = Attendants(home)
    yield made
    made.clear()


LONG = 'echo begun; touch begun; until [ -e go ]; do sleep 0.05; done; echo ended; echo "for $1" >&2; exit 9'


def test_output_errors_and_exit_code_come_through(robot: Attendants) -> None:
    """As if the script ran here; its arguments stay whole."""
    script = 'printf "%s|" "$0" "$@"; echo oops >&2; exit 3'
    assert robot.run(script, "a b", "$HOME 'c'", "") == (3, "script|a b|$HOME 'c'||", "oops\n")


def test_output_is_shown_while_it_runs(robot: Attendants) -> None:
    """A note is heard at once, not at the end."""
    one = robot.attend(LONG, "tim")
    assert one.stdout
    assert one.stdout.readline() == "begun\n"
    assert one.poll() is None
    (robot.home / "go").touch()
    assert robot.ended(one) == (9, "ended\n", "for tim\n")


@pytest.mark.parametrize("sent", [signal.SIGHUP, signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_it_goes_on_without_the_desktop(robot: Attendants, sent: signal.Signals) -> None:
    """Whatever ends the whole session of the desktop's command; the same token shows everything, once."""
    one = robot.attend(LONG, "tim")
    assert eventually((robot.home / "begun").exists)
    os.killpg(one.pid, sent)
    robot.ended(one)
    (robot.home / "begun").unlink()
    (robot.home / "go").touch()
    assert robot.run(LONG, "tim") == (9, "begun\nended\n", "for tim\n")
    assert not (robot.home / "begun").exists()


def test_coming_back_to_what_has_ended(robot: Attendants) -> None:
    """The result is kept: the script does not run a second time."""
    script = "echo x >> count; cat count; exit 4"
    assert robot.run(script) == (4, "x\n", "")
    assert robot.run(script) == (4, "x\n", "")
    assert robot.run(script, run_name="run.2") == (4, "x\nx\n", "")


def test_two_who_watch_at_once(robot: Attendants) -> None:
    """Both see everything, and it runs once."""
    both = [robot.attend(LONG, "tim") for _ in range(2)]
    assert eventually((robot.home / "begun").exists)
    (robot.home / "go").touch()
    assert [robot.ended(one) for one in both] == [(9, "begun\nended\n", "for tim\n")] * 2


def test_much_output_of_any_bytes(robot: Attendants) -> None:
    """Nothing is lost or doubled where it is read in pieces."""
    script = "i=0; while [ $i -lt 300 ]; do printf 'line %s räuber\\n' $i; i=$((i + 1)); [ $((i % 100)) != 0 ] || sleep 0.3; done"
    code, out, _ = robot.run(script)
    assert code == 0
    assert out.splitlines() == [f"line {number} räuber" for number in range(300)]


def test_a_process_that_died_is_told(robot: Attendants) -> None:
    """Killed, or gone with the robot: the desktop does not wait for ever."""
    one = robot.attend(LONG, "tim")
    process = robot.runs / "run.1/process"
    assert eventually((robot.home / "begun").exists)
    os.killpg(int(process.read_text()), signal.SIGKILL)
    began = time.monotonic()
    code, out, errors = robot.ended(one)
    assert (code, out) == (74, "begun\n")
    assert errors == "the command ended early: the robot was restarted, or the command was killed\n"
    assert time.monotonic() - began < 10


def test_what_a_power_cut_has_ended_goes_on_when_the_desktop_is_back(robot: Attendants) -> None:
    """From its beginning: it is a script that may be run again. Its end is kept as that of any other."""
    one = robot.attend(LONG, "tim")
    assert eventually((robot.home / "begun").exists)
    os.killpg(int((robot.runs / "run.1/process").read_text()), signal.SIGKILL)
    robot.ended(one)
    (robot.runs / "run.1/boot").write_text("another\n")
    (robot.home / "go").touch()
    shown = "note: was cut short: goes on\nbegun\nended\n"
    assert robot.run(LONG, "tim") == (9, shown, "for tim\n")
    assert robot.run(LONG, "tim") == (9, "begun\nended\n", "for tim\n")


def test_it_is_started_again_once_whoever_does_it(robot: Attendants) -> None:
    """The unit of `provision` and a desktop may come at the same time."""
    script = 'echo "$FLEET_RUN" >> count; sleep 0.5'
    robot.run(script)
    (robot.runs / "run.1/code").unlink()
    both = [
        subprocess.Popen(("sh", robot.runs / "run.1/start", robot.runs / "run.1"), cwd=robot.home)
        for _ in range(2)
    ]
    assert [one.wait(10) for one in both] == [0, 0]
    assert (robot.home / "count").read_text() == "run.1\n" * 2


def test_the_number_of_a_dead_process_is_anothers_now(robot: Attendants) -> None:
    """After a restart of the robot numbers begin again: only the process of this run counts."""
    (robot.runs / "run.1").mkdir(parents=True)
    (robot.runs / "run.1/process").write_text(f"{os.getpid()}\n")
    assert robot.run("echo never")[0] == 74


def test_a_folder_that_cannot_be_made(robot: Attendants) -> None:
    """The reason is the system's, and the script did not run."""
    robot.runs.mkdir(parents=True)
    code, out, errors = robot.run("echo never", run_name="no/such/folder")
    assert (code, out) == (1, "")
    assert "No such file or directory" in errors


def test_old_runs_are_removed(robot: Attendants) -> None:
    """After a week nobody comes back; what is younger stays."""
    for name, days in (("old", 9), ("young", 1)):
        (robot.runs / name).mkdir(parents=True)
        past = time.time() - days * 86400
        os.utime(robot.runs / name, (past, past))
    robot.run("true")
    assert sorted(path.name for path in robot.runs.iterdir()) == ["run.1", "young"]


@pytest.mark.parametrize("note", ["journal", "dev/back"])
def test_what_is_still_to_be_done_is_not_old(robot: Attendants, note: str) -> None:
    """A swap that is to be finished, and the end of dev at the next boot, however long the robot has been on."""
    run = robot.runs / "waiting"
    run.mkdir(parents=True)
    os.utime(run, (1, 1))
    path = robot.home / ".fleet/stacks/nav" / note
    path.parent.mkdir(parents=True)
    path.write_text("waiting\n")
    robot.run("true")
    assert run.exists()
    path.unlink()
    robot.run("true", run_name="run.2")
    assert not run.exists()


def test_a_full_disk_is_told_at_once_and_nothing_is_started(robot: Attendants) -> None:
    """A script of which a half was written would not end, and nobody would know why."""
    if (robot.home.parent / "bin/sh").resolve().name == "busybox":
        pytest.skip("it has a cat of its own, in which no error can be injected")
    cat = robot.home.parent / "bin/cat"
    cat.write_text(
        "#!/bin/sh\n"
        "case $(readlink /proc/$$/fd/1) in\n"
        "    */runs/*) echo 'cat: write error: No space left on device' >&2 && exit 1 ;;\n"
        "esac\n"
        'exec /bin/cat "$@"\n'
    )
    cat.chmod(0o755)
    what = "nothing was started: cat: write error: No space left on device\n"
    assert robot.run("touch begun") == (1, "", what)
    assert list(robot.runs.iterdir()) == []
    cat.unlink()
    assert robot.run("echo well") == (0, "well\n", "")
