"""A real SSH server, the scripts of a robot, and the Docker of this computer."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import pytest

from fleet.config.watch import Hook, Rule
from fleet.errors import CommandFailed, FleetError, NotReady
from fleet.images.emulation import desktop_platform
from fleet.plan.compose_steps import Request
from fleet.plan.outcome import Outcome
from fleet.rollout.dev import Session, Target
from fleet.rollout.dev_robot import attend
from fleet.rollout.link import Link
from fleet.rollout.sync_archive import Archives
from tests.support.dev_stack import DevStack
from tests.support.homes import Told, identity, start
from tests.support.lab_project import eventually
from tests.support.small_image import make_image

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.rollout.dev import Ship
    from tests.support.sshd import Sshds


@pytest.fixture(scope="module")
def image(desktop: None) -> Iterator[str]:  # noqa: ARG001  it marks the test
    yield from make_image(("sh", "cat", "sleep", "rm", "touch"))


@dataclass(frozen=True, kw_only=True)
class Reachable(DevStack):
    """A stack on a robot that SSH reaches."""

    robot: Robot


class Person:
    """Somebody with `fab dev` on one robot, and the folder in which they save files."""

    def __init__(
        self, path: Path, robot: Reachable, link: Link, *, rebuild: Callable[[], Ship] | None = None
    ) -> None:
        self.src = path / "src"
        self.src.mkdir(parents=True)
        (path / "packed").mkdir()
        (path / "exec").mkdir()
        (path / "Dockerfile").write_text("")
        self.path = path
        self.link = link
        self.told = Told()
        self.lines: list[str] = []
        self.outcome: Outcome | FleetError | None = None
        hook = Hook(command=("touch", "/app/touched"))
        target = Target(
            stack=robot.name,
            rules=(
                Rule(service="node", action="sync+restart", path=str(self.src), target="/app"),
                Rule(service="node", action="sync+exec", path=str(path / "exec"), target="/exec", hook=hook),
                Rule(service="node", action="rebuild", path=str(path / "Dockerfile")),
            ),
            request=Request(by=f"{path.name}@desktop", run="r", wait=10, settle=1),
        )
        self.session = Session(
            {link.robot.name: target},
            archives=Archives(path / "packed"),
            rebuild=rebuild or self._no_build,
            progress=self.told,
            printer=lambda _name, text: self.lines.append(text),
        )
        self._following = self.session.following()
        self._thread = threading.Thread(target=self._run)

    def _no_build(self) -> Ship:
        raise AssertionError

    def _run(self) -> None:
        try:
            self.outcome = attend(self.link, session=self.session)
        except FleetError as problem:
            self.outcome = problem

    def __enter__(self) -> Self:
        self._following.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()
        self._following.__exit__(None, None, None)
        self._thread.join(20)

    def save(self, name: str, text: str) -> None:
        new = self.src / f"{name}.swp"
        new.write_text(text)
        new.replace(self.src / name)

    def await_status(self, text: str) -> None:
        def seen() -> bool:
            return any(text in title for _, title, _ in self.told.began_with)

        assert eventually(seen, within=40), (self.told.began_with, self.told.said, self.outcome)

    def await_note(self, text: str) -> None:
        assert eventually(lambda: any(text in said for _, said in self.told.said), within=40), self.told.said

    def await_end(self) -> Outcome | FleetError:
        self._thread.join(40)
        assert self.outcome
        return self.outcome


@pytest.fixture
def robot(sshds: Sshds, image: str) -> Iterator[Reachable]:
    home = start(sshds, "pi1")
    (home.path / ".fleet").mkdir()
    made = Reachable(home=home.path, image=image, robot=home.robot)
    made.start()
    wrapper = sshds.folder / "bin/docker"
    (identity(sshds.folder, "pi1") / "docker").write_bytes(wrapper.read_bytes())
    (identity(sshds.folder, "pi1") / "docker").chmod(0o755)
    yield made
    made.clear()


def link(robot: Reachable) -> Link:
    return Link(robot.robot.model_copy(update={"platform": desktop_platform()}))


@pytest.fixture
def tim(robot: Reachable, tmp_path: Path) -> Iterator[Person]:
    with Person(tmp_path / "tim", robot, link(robot)) as person:
        person.await_status("in step; node running")
        yield person


def test_a_save_is_in_the_container(robot: Reachable, tim: Person) -> None:
    """The service has read it, its lines are printed, and the robot's line says what was done."""
    tim.save("node", "echo hello from the node\n")
    tim.await_status("synced 1 file, node restarted in ")
    assert robot.read("/app/node") == "echo hello from the node\n"
    assert eventually(lambda: "hello from the node" in tim.lines)
    (tim.src / "node").unlink()
    assert eventually(lambda: robot.read("/app/node") is None)


def test_a_command_after_a_sync(robot: Reachable, tim: Person) -> None:
    """No restart: `sync+exec`."""
    before = robot.logs()
    assert robot.read("/app/touched") is None
    (tim.path / "exec/a").write_text("1")
    tim.await_status("synced 1 file in ")
    assert robot.read("/exec/a") == "1"
    assert robot.read("/app/touched") == ""
    assert before == robot.logs()


def test_a_robot_that_was_away_gets_all_of_it(robot: Reachable, tim: Person) -> None:
    """Whatever was saved meanwhile, in one sync."""
    tim.link.session.close()
    for number in range(5):
        tim.save(f"file{number}", str(number))
    assert eventually(
        lambda: [robot.read(f"/app/file{number}") for number in range(5)] == list("01234"), within=40
    )


def test_a_robot_that_is_away_is_told_once(tim: Person, sshds: Sshds) -> None:
    """However often it is looked for: who reads that in a file would find nothing else there."""
    tim.await_status("in step")
    sshds.stop()
    tim.await_status("away (")
    time.sleep(5)  # two more attempts
    lines = [title for _, title, _ in tim.told.began_with if title.startswith(("away", "look"))]
    assert [line.partition(" ")[0] for line in lines] in (["look", "away"], ["look", "away", "away"])


def test_a_container_that_does_not_come_back(robot: Reachable, tim: Person) -> None:
    """Why, its last lines, and both ways out; then the corrected file, and all is well."""
    tim.save("node", "echo lidar is missing; exit 7\n")
    tim.await_note("node ends again and again (exit code 7)")
    tim.await_note("  node: lidar is missing")
    tim.await_note("correct the file and save it, or `fab dev --end --hosts pi1` brings release one back")
    tim.save("node", "echo corrected\n")
    assert eventually(lambda: "corrected" in robot.logs(), within=40)
    seen = len(tim.told.began_with)
    assert eventually(
        lambda: any("; node running" in title for _, title, _ in tim.told.began_with[seen - 1 :])
    )


def test_somebody_brings_the_release_back(robot: Reachable, tim: Person) -> None:
    """That ends dev on this robot, and says who it was."""
    robot.swap("dev")
    outcome = tim.await_end()
    assert isinstance(outcome, Outcome)
    assert (outcome.status, "dev one tim@desktop done" in outcome.summary) == ("done", True)


def test_two_people(robot: Reachable, tim: Person, tmp_path: Path) -> None:
    """The second one hears who is there."""
    with Person(tmp_path / "ada", robot, link(robot)) as ada:
        problem = ada.await_end()
    assert isinstance(problem, CommandFailed)
    assert (problem.what, problem.cure.partition(":")[0]) == (
        "tim@desktop has `fab dev` on this robot",
        "one person at a time",
    )
    assert tim.outcome is None


def test_a_new_image_is_shipped_and_dev_goes_on(robot: Reachable, tmp_path: Path) -> None:
    """The containers of the ship have no file of before; the next save reaches the new ones."""

    def ship(link: Link) -> Outcome:
        robot.swap("ship")
        return Outcome(robot=link.robot.name, status="done")

    with Person(tmp_path / "tim", robot, link(robot), rebuild=lambda: ship) as tim:
        tim.await_status("in step; node running")
        tim.save("node", "echo before\n")
        tim.await_status("synced 1 file")
        before = robot.ids
        (tim.path / "Dockerfile").write_text("FROM x")
        assert eventually(lambda: robot.ids not in ([], before), within=40)
        time.sleep(0.5)
        tim.save("node", "echo after\n")
        assert eventually(lambda: robot.ids and robot.read("/app/node") == "echo after\n", within=40)
        assert tim.outcome is None


def test_nothing_was_shipped(robot: Reachable, tmp_path: Path) -> None:
    """What to do first."""
    robot.clear()
    with Person(tmp_path / "tim", robot, link(robot)) as tim:
        problem = tim.await_end()
    assert isinstance(problem, NotReady)
    assert problem.cure.startswith("`fab build --hosts pi1` and `fab ship --hosts pi1`")
