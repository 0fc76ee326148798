from __future__ import annotations

import os
from typing import TYPE_CHECKING

from fleet.plan import compose_steps
from fleet.plan.step import Bytes, Step
from fleet.robot import paths
from tests.support.robot_shell import do
from tests.support.samples import PI, release

if TYPE_CHECKING:
    from pathlib import Path


def tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file below a folder: its mode and its bytes."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(p.relative_to(folder)): (p.stat().st_mode & 0o777, p.read_bytes()) for p in files}


def test_a_release_arrives_with_its_bytes_and_modes(home: Path) -> None:
    """``.env`` may hold secrets; what containers mount is readable by them."""
    new = release()
    done = do(compose_steps.write(new), home)
    assert (done.returncode, done.stderr) == (0, b"")
    assert tree(home / paths.folder(new.id)) == {
        name: (0o600 if name == ".env" else 0o644, data) for name, data in new.files.items()
    }
    assert (home / paths.folder(new.id) / "files").is_dir()


def test_writing_a_release_again_leaves_its_files_in_place(home: Path) -> None:
    """Running containers have them mounted: a file replaced by an equal one would be a deleted one to them."""
    new = release()
    do(compose_steps.write(new), home)
    before = {path: path.stat().st_ino for path in home.rglob("*")}
    assert do(compose_steps.write(new), home).returncode == 0
    assert {path: path.stat().st_ino for path in home.rglob("*")} == before


def test_a_damaged_release_is_made_whole_again(home: Path) -> None:
    """Whatever was cut, edited or added by hand, the directory is what the release says."""
    new = release()
    folder = home / paths.folder(new.id)
    do(compose_steps.write(new), home)
    (folder / ".env").write_bytes(b"")
    (folder / "extra").write_text("by hand")
    part = folder.with_name(folder.name + paths.PART)
    part.mkdir()
    (part / "half").write_bytes(b"written before the power went")
    os.utime(part, (0, 0))  # long ago: what is new may be somebody else's, who ships at this moment
    assert do(compose_steps.write(new), home).returncode == 0
    assert {name: data for name, (_, data) in tree(folder).items()} == dict(new.files)
    assert [path.name for path in folder.parent.iterdir()] == [new.id]


def test_an_archive_that_was_cut_replaces_nothing(home: Path) -> None:
    """The link died in the middle of the bytes: the release that was there stays, and the step fails."""
    new = release()
    step = compose_steps.write(new)
    do(step, home)
    before = tree(home / paths.folder(new.id))
    assert isinstance(step.feed, Bytes)
    cut = Step(title="", argv=step.argv, feed=Bytes(label="", data=step.feed.data[:1300]))
    assert do(cut, home).returncode != 0
    assert tree(home / paths.folder(new.id)) == before


def test_a_file_name_with_spaces_and_quotes_arrives(home: Path, tmp_path: Path) -> None:
    """Names come from the inventory and go through tar, never through a shell."""
    (tmp_path / "here").write_text("42")
    odd = "odd/it's $HOME `x`.yaml"
    new = release(robot=PI.model_copy(update={"files": {odd: tmp_path / "here"}}))
    assert do(compose_steps.write(new), home).returncode == 0
    assert (home / paths.folder(new.id) / "files" / odd).read_text() == "42"
