"""What `sh install` refuses; that it installs is for tests/lab/test_bundle.py."""

from __future__ import annotations

import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.bundle.write import SUMS, Writer
from tests.support.bundles import ROBOT, bundle, release

if TYPE_CHECKING:
    from pathlib import Path

DOCKER = """#!/bin/sh
case "$1 $*" in
    version*) [ -z "$DOWN" ] || { echo "$DOWN" >&2; exit 1; } ;;
    ps*label=fleet.robot*) printf '%s' "$SHIPPED" ;;
    *) exit 0 ;;
esac
"""


class Stick:
    """A stick in a computer: `install` with a Docker that is a few words."""

    def __init__(self, home: Path, *robots: str, **values: object) -> None:
        if "busybox" in str((home.parent / "bin/sh").resolve()):
            pytest.skip("it has a uname of its own")
        self.folder = home.parent / "stick"
        self.home = home
        self.folder.mkdir(exist_ok=True)
        robot = ROBOT.model_copy(update=values)
        Writer(self.folder).write(bundle(*robots, robot=robot)[1])
        (home.parent / "bin/docker").write_text(DOCKER)
        (home.parent / "bin/docker").chmod(0o755)
        (home.parent / "bin/uname").write_text('#!/bin/sh\n[ "$1" = -n ] && echo "$NAME" || echo x86_64\n')
        (home.parent / "bin/uname").chmod(0o755)
        (home.parent / "bin/dpkg").write_text("#!/bin/sh\necho amd64\n")
        (home.parent / "bin/dpkg").chmod(0o755)

    def says(self, *arguments: str, name: str = "pi1", shipped: str = "", down: str = "") -> str:
        """What it complains of; it must."""
        environment = {
            "PATH": f"{self.home.parent / 'bin'}:{os.environ['PATH']}",
            "HOME": str(self.home),
            "NAME": name,
            "SHIPPED": shipped,
            "DOWN": down,
        }
        shell = str(self.home.parent / "bin/sh")
        argv = (shell, str(self.folder / "install"), *arguments)
        done = subprocess.run(argv, env=environment, capture_output=True, text=True, timeout=30, check=False)
        assert done.returncode == 1, (done.stdout, done.stderr)
        assert done.stderr.count("  cure: ") == 1, done.stderr
        return done.stderr


def test_the_wrong_robot_is_refused_with_those_that_the_stick_has(home: Path) -> None:
    """By its name, by what runs there, and by what a person says."""
    stick = Stick(home)
    assert "releases for pi1, pi2, and nothing says that this computer (other)" in stick.says(name="other")
    assert "nothing for pi9; it has: pi1, pi2" in stick.says("pi9")
    assert "is called pi1, and the bundle has releases for pi1 too" in stick.says("pi2")
    assert "was shipped to as pi7, not as pi1" in stick.says(shipped="pi7\n")
    assert "was shipped to as pi2, not as pi1" in stick.says("pi1", shipped="pi2\n")
    assert "there is no option --force" in stick.says("--force")


def test_the_wrong_processor_and_the_wrong_user_are_refused(home: Path) -> None:
    """Before Docker is asked anything."""
    stick = Stick(home, "pi1", platform="linux/arm/v7")
    if not os.path.exists("/proc/sys/fs/binfmt_misc/qemu-arm"):  # noqa: PTH110
        assert "for another processor than this one's (x86_64)" in stick.says()
    assert "logs in to pi1 as nobody-else, and this is" in Stick(home, "pi1", user="nobody-else").says()


def test_a_robot_that_is_not_ready_is_told_what_it_lacks(home: Path) -> None:
    """As `fab ship` does."""
    stick = Stick(home, "pi1")
    assert "may not use Docker" in stick.says(down="permission denied while trying to connect")
    assert "Docker does not answer: no socket" in stick.says(down="no socket")


@pytest.mark.parametrize("name", ["index-*", "releases/*", "images/*", "programs-*/swap.sh"])
def test_a_stick_that_was_edited_is_refused(home: Path, name: str) -> None:
    """Whatever is used; a file that is missing too."""
    stick = Stick(home, "pi1")
    (file,) = stick.folder.glob(name)
    file.write_bytes(file.read_bytes()[:-1])
    wanted = f"{file.relative_to(stick.folder)} on the stick is not what fab bundle wrote"
    assert wanted in stick.says()
    file.unlink()
    assert wanted in stick.says()
    (stick.folder / SUMS).unlink()
    assert "is not whole: SHA256SUMS is missing" in stick.says()


def test_a_program_that_was_cut_off_does_nothing(home: Path) -> None:
    """At any place: the shell reads it to its end first."""
    stick = Stick(home, "pi1")
    text = (stick.folder / "install").read_bytes()
    shell = str(home.parent / "bin/sh")
    for size in range(1000, len(text) - 3, 1501):
        (stick.folder / "install").write_bytes(text[:size])
        done = subprocess.run(
            (shell, str(stick.folder / "install")), capture_output=True, text=True, check=False
        )
        assert (done.returncode != 0, done.stdout) == (True, ""), size
    assert list(home.iterdir()) == []


def test_an_older_stick_is_refused(home: Path) -> None:
    """Older than a ship over SSH, than a rollback, and than another stick: by when that was made, not put in."""
    stick = Stick(home, "pi1")
    here = home / ".fleet/stacks/talker"
    here.mkdir(parents=True)
    later, earlier = "2026-11-28T12:00:01Z", "2026-11-28T11:59:59Z"
    events = {
        f"{later}\tship\tabc\ttim@desktop\tdone": True,
        f"{later}\trollback\tabc\ttim@desktop\tdone": True,
        f"{earlier}\tship\tabc\ttim@desktop by stick of {later}\tdone": True,
        f"{later}\tship\tabc\ttim@desktop by stick of {earlier}\tdone": False,
        f"{earlier}\tship\tabc\ttim@desktop\tdone": False,
        f"{later}\tship\tabc\ttim@desktop\tfailed: tick": False,
    }
    for line, newer in events.items():
        (here / "history").write_text(f"{line}\n")
        said = stick.says()
        assert ("something newer has come to pi1 since" in said) == newer, line
        assert ("sh install pi1 --older" in said) == newer, line


def test_the_release_is_written_as_ship_writes_it(home: Path) -> None:
    """With the login's home in it: `fab ship` must find nothing to do. (Here the image cannot be loaded.)"""
    Stick(home, "pi1").says()
    wanted = release()
    folder = home / ".fleet/stacks/talker/releases" / wanted.id
    for name, file in wanted.files(str(home)).items():
        path = folder / name
        if file.folder:
            assert path.stat().st_mode & 0o777 == file.mode, name
        elif file.link is None:
            assert (path.read_bytes(), path.stat().st_mode & 0o777) == (file.data, file.mode), name
        else:
            assert str(path.readlink()) == file.link
