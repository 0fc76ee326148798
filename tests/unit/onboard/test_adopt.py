from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.plan import compose_steps
from tests.support.robot_shell import do

if TYPE_CHECKING:
    from pathlib import Path

OVERRIDE = '{\n  "name": "nav",\n  "services": {}\n}\n'


@pytest.fixture
def fleet(home: Path) -> Path:
    """What the first version of fleet has left in a robot's home."""
    fleet = home / ".fleet"
    for name in ("aaa", "bbb"):
        (fleet / "releases" / name / "files").mkdir(parents=True)
        (fleet / "releases" / name / "compose.override.yaml").write_text(OVERRIDE)
        (fleet / "releases" / name / "files/map").write_text(name)
    (fleet / "current").symlink_to("releases/bbb")
    (fleet / "history").write_text("one\n")
    return fleet


def adopted(home: Path) -> None:
    done = do(compose_steps.adopt("nav"), home)
    assert (done.returncode, done.stderr) == (0, b"")


def test_releases_history_and_the_current_one_are_the_stacks(home: Path, fleet: Path) -> None:
    """Nothing is copied: what containers have mounted are the same files as before."""
    before = (fleet / "releases/bbb/files/map").stat().st_ino
    adopted(home)
    stack = fleet / "stacks/nav"
    assert sorted(path.name for path in (stack / "releases").iterdir()) == ["aaa", "bbb"]
    assert not (stack / "releases/bbb").is_symlink()
    assert str((stack / "current").readlink()) == "releases/bbb"
    assert (stack / "current/files/map").stat().st_ino == before
    assert (stack / "history").read_text() == "one\n"
    assert not (fleet / "current").is_symlink()
    assert not (fleet / "history").exists()


def test_the_old_names_still_lead_to_the_files(home: Path, fleet: Path) -> None:
    """A container that restarts looks for its mounts where it was made."""
    adopted(home)
    assert [(fleet / f"releases/{name}/files/map").read_text() for name in ("aaa", "bbb")] == ["aaa", "bbb"]


def test_a_second_time_changes_nothing(home: Path, fleet: Path) -> None:
    """Also where a power cut has stopped it after the first folder."""
    (fleet / "stacks/nav/releases").mkdir(parents=True)
    (fleet / "releases/aaa").rename(fleet / "stacks/nav/releases/aaa")
    (fleet / "releases/aaa").symlink_to("../stacks/nav/releases/aaa")
    adopted(home)
    before = {str(path): path.lstat().st_ino for path in fleet.rglob("*")}
    adopted(home)
    assert {str(path): path.lstat().st_ino for path in fleet.rglob("*")} == before
    assert (fleet / "releases/aaa/files/map").read_text() == "aaa"


def test_what_the_power_cut_between_a_folder_and_its_link_is_finished(home: Path, fleet: Path) -> None:
    """The release has moved; its old name is missing, and containers need it."""
    (fleet / "stacks/nav/releases").mkdir(parents=True)
    (fleet / "releases/aaa").rename(fleet / "stacks/nav/releases/aaa")
    adopted(home)
    assert (fleet / "releases/aaa/files/map").read_text() == "aaa"


def test_what_the_stack_has_already_stays(home: Path, fleet: Path) -> None:
    """A current release of the new kind is newer than the old one."""
    stack = fleet / "stacks/nav"
    (stack / "releases/ccc").mkdir(parents=True)
    (stack / "current").symlink_to("releases/ccc")
    (stack / "history").write_text("two\n")
    adopted(home)
    assert str((stack / "current").readlink()) == "releases/ccc"
    assert (stack / "history").read_text() == "two\n"


def test_what_is_no_release_stays_where_it_is(home: Path, fleet: Path) -> None:
    """A folder of somebody's."""
    (fleet / "releases/mine").mkdir()
    (fleet / "releases/mine/note").write_text("keep")
    adopted(home)
    assert (fleet / "releases/mine/note").read_text() == "keep"
    assert not (fleet / "releases/mine").is_symlink()
    assert not (fleet / "stacks/nav/releases/mine").exists()
