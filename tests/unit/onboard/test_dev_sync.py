"""The script runs for real, on the Docker of this computer, with a project of a name that nobody else has."""

from __future__ import annotations

import hashlib
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.onboard.exit_codes import BROKEN_OFF
from fleet.plan import dev_steps
from fleet.plan.watch import GONE, Change, Entry
from fleet.rollout.sync_archive import Archives
from tests.support.dev_stack import DevStack
from tests.support.small_image import make_image

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path


@pytest.fixture(scope="module")
def image(desktop: None) -> Iterator[str]:  # noqa: ARG001  it marks the test
    yield from make_image(("sh", "cat", "sleep", "rm"))


@pytest.fixture(scope="module")
def bare_image(desktop: None) -> Iterator[str]:  # noqa: ARG001  it marks the test
    """Neither `rm` nor `tar`."""
    yield from make_image(("sh", "cat", "sleep"))


class Desk:
    """A desktop with some files, and a robot whose stack is in dev."""

    def __init__(self, robot: DevStack, folder: Path) -> None:
        self.robot = robot
        self.folder = folder
        robot.dev.mkdir()
        (robot.dev / "session").write_text("me\n")
        (robot.dev / "state").write_text("2026-11-28T12:00:00Z tim@desktop\n")
        self._archives = 0

    def sync(
        self, files: Mapping[str, str | None], *, restart: bool = False, offset: int = 0, end: int | None = None, session: str = "me"
    ) -> subprocess.CompletedProcess[str]:  # fmt: skip
        """Bring files to the container; those that are None are removed."""
        changes, tree = [], {}
        for place, text in files.items():
            source = self.folder / hashlib.sha256(place.encode()).hexdigest()
            if text is not None:
                if not source.exists() or source.read_text() != text:
                    source.write_text(text)
                tree[str(source)] = Entry(digest="x", size=len(text))
            verb, digest = ("gone", GONE) if text is None else ("put", "x")
            changes.append(Change(verb=verb, service="node", digest=digest, place=place, source=str(source)))
        self._archives += 1
        packed = self.folder / f"packed-{self._archives}"
        packed.mkdir()
        archive = Archives(packed).of(tuple(changes), tree)
        self.parts = self.robot.dev / f"in-{archive.name}"
        services = ("node",) if restart else ()
        argv = dev_steps.sync(
            self.robot.name,
            session=session,
            name=archive.name,
            size=archive.size,
            offset=offset,
            restart=services,
        )
        return self.robot.run(argv, data=archive.path.read_bytes()[offset:end])

    @property
    def has(self) -> dict[str, str]:
        lines = (self.robot.dev / "has-node").read_text().splitlines()[1:]
        return {place: digest for digest, _, place in (line.partition(" ") for line in lines)}


def start(tmp_path: Path, image: str) -> Iterator[Desk]:
    (tmp_path / "home/.fleet").mkdir(parents=True)
    (tmp_path / "desk").mkdir()
    robot = DevStack(home=tmp_path / "home", image=image)
    robot.start()
    yield Desk(robot, tmp_path / "desk")
    robot.clear()


@pytest.fixture
def desk(tmp_path: Path, image: str) -> Iterator[Desk]:
    yield from start(tmp_path, image)


@pytest.fixture
def bare(tmp_path: Path, bare_image: str) -> Iterator[Desk]:
    yield from start(tmp_path, bare_image)


def digest(text: str) -> str:
    return f"{hashlib.sha256(text.encode()).hexdigest()}.644"


def test_files_arrive_and_the_service_starts_again(desk: Desk) -> None:
    """Names with spaces and quotes too; what the container has is noted with its digest."""
    name = "/app/it's a file; $(rm)"
    done = desk.sync({"/app/node": "echo hello\n", name: "x", "/new/deep/er": "y"}, restart=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert desk.robot.read("/app/node") == "echo hello\n"
    assert desk.robot.read(name) == "x"
    assert desk.robot.read("/new/deep/er") == "y"
    assert desk.robot.logs().splitlines()[-2:] == ["echo hello", "hello"]
    assert desk.has == {"/app/node": digest("echo hello\n"), name: digest("x"), "/new/deep/er": digest("y")}
    assert sorted(path.name for path in desk.robot.dev.iterdir()) == ["busy", "has-node", "session", "state"]


def test_a_file_that_is_gone_is_removed(desk: Desk) -> None:
    """And noted as that; one that was never there is no error."""
    assert desk.sync({"/app/a": "1", "/app/b": "2"}).returncode == 0
    done = desk.sync({"/app/a": None, "/app/never": None})
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert desk.robot.read("/app/a") is None
    assert desk.robot.read("/app/b") == "2"
    assert desk.has == {"/app/a": GONE, "/app/b": digest("2"), "/app/never": GONE}


def test_a_removal_does_not_keep_a_repair_from_a_container_that_has_ended(desk: Desk) -> None:
    """Nothing can be removed from it before it runs again, and what comes with the removal may be what it lacks."""
    assert desk.sync({"/app/old": "1", "/app/node": "exit 7\n"}).returncode == 0
    subprocess.run(("docker", "stop", *desk.robot.ids), check=True, capture_output=True)
    done = desk.sync({"/app/old": None, "/app/node": "echo repaired\n"}, restart=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert desk.robot.read("/app/old") is None
    assert desk.has == {"/app/old": GONE, "/app/node": digest("echo repaired\n")}


def test_what_has_not_been_restarted_is_not_remembered(desk: Desk) -> None:
    """The desktop brings it again: else the old program would run, and the robot would count as in step."""
    docker = desk.robot.home.parent / "bin/docker"
    real = docker.read_text()
    docker.write_text(
        real.replace("#!/bin/sh\n", '#!/bin/sh\n[ "$1" != restart ] || { echo no >&2; exit 1; }\n', 1)
    )
    done = desk.sync({"/app/node": "echo new\n"}, restart=True)
    assert (done.returncode, done.stderr) == (1, "the restart failed: no\n")
    assert desk.has == {}


def test_an_image_without_rm_and_tar(bare: Desk) -> None:
    """Files arrive all the same; one that should go is told, once and with the way out."""
    assert bare.sync({"/app/a": "1"}).returncode == 0
    assert bare.robot.read("/app/a") == "1"
    done = bare.sync({"/app/a": None})
    assert done.returncode == 0
    assert "1 files stay in the container, because its image has no `rm`" in done.stdout
    assert bare.has == {"/app/a": GONE}


def test_an_upload_that_was_cut_goes_on(desk: Desk) -> None:
    """Nothing reaches the container before all of it is there; the rest is enough then."""
    text = "".join(f"{number}\n" for number in range(20000))
    cut = desk.sync({"/app/big": text}, end=1000)
    assert (cut.returncode, cut.stderr) == (BROKEN_OFF, "the upload was cut\n")
    assert desk.robot.read("/app/big") is None
    assert desk.parts.stat().st_size == 1000
    assert desk.sync({"/app/big": text}, offset=1000).returncode == 0
    assert desk.robot.read("/app/big") == text


def test_a_damaged_upload_is_not_used(desk: Desk) -> None:
    """Bytes of another upload in its place: it begins anew."""
    assert desk.sync({"/app/a": "1" * 5000}, end=20).returncode == BROKEN_OFF
    desk.parts.write_bytes(b"z" * 20)
    done = desk.sync({"/app/a": "1" * 5000}, offset=20)
    assert (done.returncode, done.stderr) == (BROKEN_OFF, "the upload was damaged\n")
    assert not desk.parts.exists()


def test_a_robot_that_was_brought_back_takes_nothing(desk: Desk) -> None:
    """Somebody shipped meanwhile, or another desktop has it."""
    done = desk.sync({"/app/a": "1"}, session="other")
    assert (done.returncode, done.stderr) == (BROKEN_OFF, "this robot was brought back to a release\n")
    assert desk.robot.read("/app/a") is None


def test_containers_that_were_replaced_are_not_taken_for_the_same(desk: Desk) -> None:
    """What was synced is gone with the old ones: the desktop must ask again."""
    assert desk.sync({"/app/a": "1"}).returncode == 0
    desk.robot.run(
        ("sh", "-c", f"cd {desk.robot.folder}/releases/one && docker compose up -d --force-recreate")
    )
    done = desk.sync({"/app/b": "1"})
    assert (done.returncode, done.stderr) == (BROKEN_OFF, "its containers were replaced\n")


def test_a_file_in_place_of_a_folder_fails_with_dockers_words(desk: Desk) -> None:
    """And is not noted as there, so that it is tried again."""
    assert desk.sync({"/app/a": "1"}).returncode == 0
    done = desk.sync({"/app": "2"})
    assert done.returncode == 1
    assert done.stderr.startswith("node: docker cp: ")
    assert set(desk.has) == {"/app/a"}


def test_a_full_disk(desk: Desk, tmp_path: Path) -> None:
    """Told before a container is touched, and the upload does not keep what is left of the disk."""
    tar = tmp_path / "bin/tar"
    tar.write_text("#!/bin/sh\necho 'tar: app: Cannot write: No space left on device' >&2\nexit 2\n")
    tar.chmod(0o755)
    done = desk.sync({"/app/a": "1"})
    assert done.returncode == 1
    assert done.stderr == "the files cannot be written: tar: app: Cannot write: No space left on device\n"
    assert desk.robot.read("/app/a") is None
    assert not list(desk.robot.dev.glob("in-*")) + list(desk.robot.dev.glob("work*"))
