from __future__ import annotations

import io
import tarfile
from dataclasses import replace
from pathlib import Path

import pytest

from fleet.config.project_files import File, ProjectFiles
from fleet.plan import compose_steps
from fleet.plan.step import Bytes, Step
from fleet.robot import paths
from fleet.robot.release import Release, compose
from tests.support.robot_shell import do
from tests.support.samples import PI, PROJECT, STACK, TALKER

HOME = "/home/pi"
FILES = ProjectFiles(
    files={
        "config/nav.yaml": File(data=b"speed: 1\n"),
        "run.sh": File(data=b"#!/bin/sh\n", mode=0o755),
        "token": File(data=b"secret", mode=0o600),
        "odd/it's $HOME `x`.yaml": File(data=b"42"),
        "link": File(link="config/nav.yaml"),
        "hollow": File(folder=True, mode=0o700),
        "hollow/shared": File(folder=True, mode=0o1777),
    },
    seeds={"maps/home.pgm": File(data=b"P5")},
)


@pytest.fixture
def new() -> Release:
    """A release with files of every kind."""
    images = dict.fromkeys(STACK.services, TALKER)
    return compose(robot=PI.name, stack=STACK, project=PROJECT, files=FILES, images=images)


def tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file below a folder, but for links: its mode and its bytes."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {str(p.relative_to(folder)): (p.stat().st_mode & 0o777, p.read_bytes()) for p in files}


def whole(new: Release) -> dict[str, tuple[int, bytes]]:
    """What `tree` says of a release that has arrived."""
    return {name: (file.mode, file.data) for name, file in new.files(HOME).items() if file.regular}


def test_a_release_arrives_with_its_bytes_modes_and_links(home: Path, new: Release) -> None:
    """Odd names, too: they go through tar, never through a shell."""
    done = do(compose_steps.write(new, home=HOME), home)
    assert (done.returncode, done.stderr) == (0, b"")
    folder = home / paths.folder(new.stack, new.id)
    assert tree(folder) == whole(new)
    assert tree(folder)["compose.yaml"][0] == tree(folder)["project/token"][0] == 0o600
    assert (folder / "project/link").readlink() == Path("config/nav.yaml")
    modes = [
        (folder / name).stat().st_mode & 0o7777 for name in (".", "project/hollow", "project/hollow/shared")
    ]
    assert modes == [0o700, 0o700, 0o1777]  # other logins see nothing of it, secrets least of all


@pytest.mark.parametrize("again", [False, True])
def test_an_archive_cannot_open_the_folder(home: Path, new: Release, again: bool) -> None:
    """It may have a mode for the folder itself, or an earlier version of fleet has left the folder open."""
    folder = home / paths.folder(new.stack, new.id)
    step = compose_steps.write(new, home=HOME)
    if again:
        do(step, home)
        folder.chmod(0o755)
    else:
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w") as archive:
            top = tarfile.TarInfo(".")
            top.type, top.mode = tarfile.DIRTYPE, 0o755
            archive.addfile(top)
        assert isinstance(step.feed, Bytes)
        step = replace(step, feed=replace(step.feed, data=packed.getvalue()[:512] + step.feed.data))
    assert do(step, home).returncode == 0
    assert folder.stat().st_mode & 0o777 == 0o700


def test_writing_a_release_again_leaves_its_files_in_place(home: Path, new: Release) -> None:
    """Running containers have them mounted: a file replaced by an equal one would be a deleted one to them."""
    step = compose_steps.write(new, home=HOME)
    do(step, home)
    before = {path: path.lstat().st_ino for path in home.rglob("*")}
    assert do(step, home).returncode == 0
    assert {path: path.lstat().st_ino for path in home.rglob("*")} == before


def test_a_damaged_release_is_made_whole_and_nothing_of_it_is_removed(home: Path, new: Release) -> None:
    """What was put there by hand may be somebody's: it is beside the release afterwards."""
    step = compose_steps.write(new, home=HOME)
    folder = home / paths.folder(new.stack, new.id)
    do(step, home)
    (folder / "compose.yaml").write_bytes(b"")
    (folder / "extra").write_text("by hand")
    assert do(step, home).returncode == 0
    assert tree(folder) == whole(new)
    (aside,) = (path for path in folder.parent.glob("[!.]*") if path != folder)
    assert aside.name.startswith(f"{new.id}.replaced.")
    assert aside.name.endswith(paths.PART)
    assert (aside / "extra").read_text() == "by hand"


@pytest.mark.parametrize("part", [0.1, 0.3, 0.5, 0.7, 0.85])
def test_an_archive_that_was_cut_replaces_nothing(home: Path, new: Release, part: float) -> None:
    """The link died in the middle of the bytes, or between two files: the release that was there stays, the step fails."""
    step = compose_steps.write(new, home=HOME)
    do(step, home)
    folder = home / paths.folder(new.stack, new.id)
    (folder / "services").write_text("edited")
    before = tree(folder)
    assert isinstance(step.feed, Bytes)
    blocks = int(len(step.feed.data) * part) // 512
    for cut in (blocks * 512, blocks * 512 + 100):
        half = Step(title="", argv=step.argv, feed=Bytes(label="", data=step.feed.data[:cut]))
        assert do(half, home).returncode != 0
        assert tree(folder) == before
        assert list(folder.parent.glob("*.part")) == []  # a full disk has no room for litter


def test_the_last_file_of_a_release_is_the_one_that_is_looked_for(new: Release) -> None:
    """The script takes it for the archive's end."""
    assert max(new.files(HOME)) == "services"
