from __future__ import annotations

import os
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.robot import probe

if TYPE_CHECKING:
    from pathlib import Path

OLD = 2 * 86400
LEFT = (
    *("receipts/aa", "receipts/new", "spool/11", "stacks/nav/releases/abc.7.part/x"),
    *("pulled/references", "pulled/cc.new"),
)
KEPT = (
    *(
        "receipts/bb",
        "pulled/cc",
        "spool/lock",
        "spool/holder",
        "stacks/nav/data/x.part",
        "stacks/nav/releases/abc/x",
    ),
    "stacks/nav/releases/abc.replaced.7.part/x",
)


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """A robot's ~/.fleet with leftovers, all of them old."""
    folder = tmp_path / ".fleet"
    for name in (*LEFT, *KEPT):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("" if name == "receipts/aa" else "text")
    age(folder, OLD)
    return folder


def age(folder: Path, seconds: float) -> None:
    past = time.time() - seconds
    for path in (folder, *folder.rglob("*")):
        os.utime(path, (past, past))


def leftovers(folder: Path) -> tuple[str, ...]:
    environment = {"HOME": str(folder.parent), "PATH": os.environ["PATH"]}
    argv = probe.command(images=True)
    done = subprocess.run(argv, env=environment, capture_output=True, text=True, check=True)
    return tuple(
        name for name in probe.parse(done.stdout).fleet.image_store.leftovers if "incoming" not in name
    )


def sweep(folder: Path, *names: str) -> None:
    environment = {"HOME": str(folder.parent), "PATH": os.environ["PATH"]}
    argv = ("sh", "-c", onboard.text("sweep.sh"), "sweep", *names)
    subprocess.run(argv, env=environment, check=True)


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} - {"lock"}


def test_what_is_left_is_listed_and_removed(fleet: Path) -> None:
    """And nothing else: data, releases, and what was moved aside stay."""
    names = leftovers(fleet)
    assert sorted(names) == [
        *("pulled/cc.new", "pulled/references", "receipts/aa", "receipts/new"),
        *("spool/11", "stacks/nav/releases/abc.7.part"),
    ]
    sweep(fleet, *names)
    assert files(fleet) == set(KEPT)
    assert leftovers(fleet) == ()


def test_names_of_a_pull_that_nobody_goes_on_with(fleet: Path) -> None:
    """Docker would keep the image for their sake, although no release has it any more."""
    docker = fleet.parent / "bin" / "docker"
    docker.parent.mkdir()
    docker.write_text('#!/bin/sh\necho "$@" >> "$HOME/calls"\n')
    docker.chmod(0o755)
    (fleet / "pulled/references").write_text("127.0.0.1:4/a@sha256:11\nsomebodys:1\nreg/b@sha256:22\n")
    path = f"{docker.parent}:{os.environ['PATH']}"
    argv = ("sh", "-c", onboard.text("sweep.sh"), "sweep", "pulled/references")
    subprocess.run(argv, env={"HOME": str(fleet.parent), "PATH": path}, check=True)
    assert (fleet.parent / "calls").read_text().splitlines() == [
        "image rm 127.0.0.1:4/a@sha256:11",
        "image rm reg/b@sha256:22",
    ]
    assert "pulled/references" not in files(fleet)


def test_what_is_young_is_somebodys_work(fleet: Path) -> None:
    """A piece of an upload waits a day for the next attempt."""
    age(fleet, 7200)
    assert sorted(leftovers(fleet)) == ["receipts/aa", "receipts/new", "stacks/nav/releases/abc.7.part"]
    age(fleet, 60)
    assert leftovers(fleet) == ()


@pytest.mark.parametrize("lock", ["lock", "spool/lock"])
def test_nothing_is_removed_while_somebody_works(fleet: Path, lock: str) -> None:
    """The next command does it."""
    with subprocess.Popen(("flock", str(fleet / lock), "sleep", "20")) as other:
        time.sleep(0.3)
        sweep(fleet, *leftovers(fleet))
        assert files(fleet) == {*LEFT, *KEPT}
        other.kill()


def test_other_names_are_not_touched(fleet: Path) -> None:
    """Whoever says them."""
    (fleet.parent / "mine").write_text("mine")
    sweep(fleet, "../mine", "spool/../../mine", "stacks/nav/data/x.part", "stacks/nav/releases/abc", "mine")
    assert (fleet.parent / "mine").exists()
    assert files(fleet) == {*LEFT, *KEPT}
