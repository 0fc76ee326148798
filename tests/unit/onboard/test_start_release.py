from __future__ import annotations

import subprocess
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.plan import compose_steps
from fleet.robot import paths
from tests.support.robot_shell import do
from tests.support.samples import PI

if TYPE_CHECKING:
    from fleet.plan.step import Step


def switch(release: str, *command: str) -> Step:
    """Start a release, with another command in place of Compose."""
    step = compose_steps.start(PI, release, wait=1)
    return replace(step, argv=(*step.argv[: step.argv.index(release) + 1], *(command or ("true",))))


def test_a_release_that_does_not_start_is_not_made_current(home: Path) -> None:
    """The exit code of Compose is that of the step, and ``current`` stays."""
    (home / paths.folder("one")).mkdir(parents=True)
    assert do(switch("one"), home).returncode == 0
    assert do(switch("two", "sh", "-c", "exit 17"), home).returncode == 17
    assert (home / ".fleet/current").readlink() == Path("releases/one")


def test_two_people_start_one_after_the_other(home: Path) -> None:
    """What one starts has ended before the other's begins."""
    (home / ".fleet").mkdir()
    command = 'echo in >> told; while [ ! -e "$1" ]; do :; done; echo out >> told'
    argvs = [switch(name, "sh", "-c", command, "sh", "go").argv for name in ("one", "two")]
    both = [subprocess.Popen(argv, cwd=home, stdin=subprocess.PIPE) for argv in argvs]
    told = home / "told"
    end = time.monotonic() + 20
    while not told.exists():
        assert time.monotonic() < end
    soon = time.monotonic() + 0.5
    while time.monotonic() < soon:
        assert told.read_text().split() in ([], ["in"])
    (home / "go").touch()
    assert [one.wait(timeout=20) for one in both] == [0, 0]
    for one in both:
        assert one.stdin
        one.stdin.close()
    assert told.read_text().split() == ["in", "out", "in", "out"]


def test_a_start_ends_with_the_connection(home: Path) -> None:
    """Ctrl-C at the desktop closes the input: what was starting is ended, and the next person's turn comes at once."""
    (home / ".fleet").mkdir()
    with subprocess.Popen(switch("one", "sleep", "60").argv, cwd=home, stdin=subprocess.PIPE) as command:
        assert command.stdin
        command.stdin.close()
        assert command.wait(timeout=20) != 0
    assert not (home / ".fleet/current").exists()
    assert do(switch("two"), home).returncode == 0


def test_current_is_there_at_every_moment_of_a_switch(home: Path) -> None:
    """Whoever reads the link while it changes finds the old or the new release, never none."""
    for name in ("one", "two"):
        (home / paths.folder(name)).mkdir(parents=True)
    assert do(switch("one"), home).returncode == 0
    seen: set[str] = set()
    over = threading.Event()

    def read() -> None:
        while not over.is_set():
            try:
                seen.add(str((home / ".fleet/current").readlink()))
            except OSError as problem:
                seen.add(str(problem))

    reader = threading.Thread(target=read)
    reader.start()
    for name in ("two", "one") * 10:
        assert do(switch(name), home).returncode == 0
    over.set()
    reader.join()
    assert seen <= {"releases/one", "releases/two"}
    assert (home / ".fleet/current").resolve() == (home / paths.folder("one")).resolve()
    assert sorted(path.name for path in (home / ".fleet").iterdir()) == ["current", "lock", "releases"]


def test_a_switch_replaces_a_link_to_what_is_gone(home: Path) -> None:
    """A release that somebody removed by hand must not keep the next one from becoming current."""
    (home / ".fleet").mkdir()
    (home / ".fleet/current").symlink_to("releases/removed")
    assert do(switch("two"), home).returncode == 0
    assert (home / ".fleet/current").readlink() == Path("releases/two")
