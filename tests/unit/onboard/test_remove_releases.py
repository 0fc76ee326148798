from __future__ import annotations

import fcntl
import os
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path

DAY = 86400


@pytest.fixture
def stack(home: Path) -> Path:
    """A stack with three old releases, the last of which runs; Docker only notes what it is asked."""
    docker = home.parent / "bin/docker"
    docker.write_text('#!/bin/sh\necho "$*" >>"$HOME/asked"\n[ "$3" != used:fleet-9 ]\n')
    docker.chmod(0o755)
    stack = home / ".fleet/stacks/nav"
    for name in ("aaa", "bbb", "ccc"):
        made(stack, name, image=f"nav:fleet-{name}")
    (stack / "current").symlink_to("releases/ccc")
    (stack / "data").mkdir()
    (stack / "data/map").write_text("map")
    return stack


def shipping(stack: Path, name: str, *, age: int) -> None:
    """Another desktop has written a release so many seconds ago."""
    marker = stack / "releases" / f".shipping-{name}"
    marker.touch()
    os.utime(marker, times=(time.time() - age,) * 2)


def made(stack: Path, name: str, *, image: str) -> None:
    release = stack / "releases" / name
    release.mkdir(parents=True)
    (release / "compose.yaml").write_text(f'{{"services": {{"a": {{"image": "{image}"}}}}}}')


def run(home: Path, *arguments: str, stack: str = "nav", keep: int = DAY) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ("sh", "-c", onboard.text("remove_releases.sh"), "remove_releases", stack, str(keep), *arguments),
        env={"HOME": str(home), "PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )


def left(stack: Path) -> list[str]:
    return sorted(path.name for path in (stack / "releases").glob("[!.]*"))


def asked(home: Path) -> list[str]:
    return (home / "asked").read_text().splitlines() if (home / "asked").exists() else []


def test_what_is_named_goes_and_nothing_else(home: Path, stack: Path) -> None:
    """The data of the stack is no release."""
    done = run(home, "aaa", "--")
    assert (done.returncode, done.stderr) == (0, "")
    assert left(stack) == ["bbb", "ccc"]
    assert (stack / "data/map").read_text() == "map"


def test_the_current_release_stays(home: Path, stack: Path) -> None:
    """Whoever planned this looked before somebody else's rollback."""
    run(home, "aaa", "ccc", "--")
    assert left(stack) == ["bbb", "ccc"]


def test_a_release_that_a_command_is_about_to_start_stays(home: Path, stack: Path) -> None:
    """The journal names it; the power went while it was started."""
    (stack / "journal").write_text("rollback bbb ccc\n")
    run(home, "aaa", "bbb", "--")
    assert left(stack) == ["bbb", "ccc"]


def test_a_release_that_is_being_shipped_stays(home: Path, stack: Path) -> None:
    """Another desktop has just written it and will start it next; one that it gave up a day ago goes."""
    made(stack, "ddd", image="nav:fleet-ddd")
    shipping(stack, "ddd", age=60)
    shipping(stack, "bbb", age=2 * DAY)
    run(home, "aaa", "bbb", "ddd", "--")
    assert left(stack) == ["ccc", "ddd"]


def test_a_release_of_another_stack_stays(home: Path, stack: Path) -> None:
    """Two stacks may have releases of the same name."""
    other = stack.parent / "cam"
    made(other, "aaa", image="cam:fleet-aaa")
    run(home, "aaa", "--")
    assert left(other) == ["aaa"]


def test_the_old_name_of_an_adopted_release_goes_with_it(home: Path, stack: Path) -> None:
    """But not what an old name stands for that is no link."""
    old = home / ".fleet/releases"
    (old / "bbb").mkdir(parents=True)
    (old / "aaa").symlink_to("../stacks/nav/releases/aaa")
    run(home, "aaa", "bbb", "--")
    assert [path.name for path in old.iterdir()] == ["bbb"]
    assert left(stack) == ["ccc"]


def test_images_that_no_release_names_go_with_their_receipts(home: Path, stack: Path) -> None:
    """Also those of the releases that were removed before them."""
    receipts, pulled = home / ".fleet/receipts", home / ".fleet/pulled"
    receipts.mkdir()
    pulled.mkdir()
    for name in ("aaa", "bbb", "9"):
        (receipts / name).write_text("{}")
        (pulled / name).write_text("{}")
    run(home, "aaa", "--", "nav:fleet-aaa", "nav:fleet-bbb", "used:fleet-9")
    assert asked(home) == ["image rm nav:fleet-aaa", "image rm used:fleet-9"]
    for folder in (receipts, pulled):
        assert sorted(path.name for path in folder.iterdir()) == ["9", "bbb"]
    assert left(stack) == ["bbb", "ccc"]


def test_an_image_of_another_stack_stays(home: Path, stack: Path) -> None:
    """Stacks share images."""
    made(stack.parent / "cam", "xxx", image="nav:fleet-aaa")
    run(home, "aaa", "--", "nav:fleet-aaa")
    assert asked(home) == []


@pytest.mark.usefixtures("stack")
def test_an_image_of_a_release_that_is_not_adopted_yet_stays(home: Path) -> None:
    """The first version of fleet kept its releases elsewhere, and their containers may run."""
    old = home / ".fleet/releases/old"
    old.mkdir(parents=True)
    (old / "compose.override.yaml").write_text('{"services": {"a": {"image": "nav:fleet-0"}}}')
    run(home, "--", "nav:fleet-0")
    assert asked(home) == []


def test_nothing_is_removed_while_another_command_works(home: Path, stack: Path) -> None:
    """It waits for its turn."""
    (home / ".fleet/lock").touch()
    with (home / ".fleet/lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(subprocess.TimeoutExpired):
            subprocess.run(
                ("sh", "-c", onboard.text("remove_releases.sh"), "x", "nav", "0", "aaa", "--"),
                env={"HOME": str(home), "PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}"},
                timeout=0.5,
                check=False,
            )
        assert left(stack) == ["aaa", "bbb", "ccc"]
