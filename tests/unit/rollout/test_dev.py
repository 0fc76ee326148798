from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from fleet.config.watch import Rule
from fleet.errors import DesktopError
from fleet.plan.compose_steps import Request
from fleet.plan.outcome import Outcome
from fleet.plan.watch import Work
from fleet.rollout.dev import Session, Target
from fleet.rollout.sync_archive import Archives
from tests.support.homes import Told

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from fleet.rollout.dev import Ship
    from fleet.rollout.link import Link


def shipped(link: Link) -> Outcome:
    return Outcome(robot=link.robot.name, status="done")


class Desk:
    """A desktop on which somebody works, and its `fab dev`."""

    def __init__(self, path: Path) -> None:
        self.src = path / "src"
        self.src.mkdir()
        (self.src / "old").write_text("x")
        (path / "Dockerfile").write_text("FROM scratch")
        (path / "packed").mkdir()
        self.dockerfile = path / "Dockerfile"
        self.told = Told()
        self.builds: list[Ship | DesktopError] = []
        self.rules = (
            Rule(service="node", action="sync+restart", path=str(self.src), target="/app"),
            Rule(service="node", action="rebuild", path=str(self.dockerfile)),
        )
        target = Target(stack="talker", rules=self.rules, request=Request(by="tim@desktop", run="r"))
        self.session = Session(
            {"pi1": target},
            archives=Archives(path / "packed"),
            rebuild=self.rebuild,
            progress=self.told,
            printer=lambda _name, _text: None,
        )

    def rebuild(self) -> Ship:
        result = self.builds.pop(0)
        if isinstance(result, DesktopError):
            raise result
        return result

    def save(self, name: str) -> None:
        """As an editor does: nobody sees half of it."""
        (self.src / f".{name}.swp").write_text("1")
        (self.src / f".{name}.swp").replace(self.src / name)

    def lacks(self, has: dict[tuple[str, str], str] | None = None) -> Work:
        return self.session.work(self.rules, has or {})[0]

    @contextmanager
    def expecting(self, condition: Callable[[], bool]) -> Iterator[None]:
        """Whatever is done in the block makes a condition true soon."""
        yield
        with self.session.changed:
            assert self.session.changed.wait_for(condition, timeout=15)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path)
    with made.session.following():
        yield made


def test_a_saved_file_is_lacking_until_the_robot_has_it(desk: Desk) -> None:
    """What was there before is not sent."""
    assert desk.lacks() == Work()
    with desk.expecting(lambda: desk.session.version == 1):
        desk.save("new")
    work = desk.lacks()
    assert [str(one.place) for one in work.changes] == ["/app/new"]
    assert work.restart == ("node",)
    archive = desk.session.archive(*desk.session.work(desk.rules, {}))
    assert [one.place for one in archive.changes] == ["/app/new"]
    assert desk.lacks({(one.service, one.place): one.digest for one in archive.changes}) == Work()


def test_what_an_earlier_dev_has_left_is_compared(desk: Desk) -> None:
    """A file that was edited since then is sent, although no event told of it."""
    assert [one.place for one in desk.lacks({("node", "/app/old"): "other"}).changes] == ["/app/old"]


def test_a_new_image_holds_all_files(desk: Desk) -> None:
    """After the build nothing is lacking; robots are shipped to."""
    desk.builds = [shipped]
    with desk.expecting(lambda: desk.session.version == 1):
        desk.save("new")
    with desk.expecting(lambda: desk.session.generation == 1):
        desk.dockerfile.write_text("FROM x")
    assert desk.session.ship is shipped
    assert desk.lacks() == Work()
    with desk.expecting(lambda: desk.lacks().changes != ()):
        desk.save("later")
    assert ("build", "Dockerfile has changed: new images, then a ship") in desk.told.said


def test_a_build_that_fails_is_told(desk: Desk) -> None:
    """The robots keep what they have, and the next save builds again."""
    desk.builds = [DesktopError("`RUN make` ended with code 2", cure="correct it"), shipped]
    with desk.expecting(lambda: len(desk.told.said) == 3):
        desk.dockerfile.write_text("FROM x")
        while len(desk.told.said) < 3:
            pass
    assert desk.session.generation == 0
    assert desk.told.said[1:] == [
        ("build", "failed: `RUN make` ended with code 2; correct it"),
        ("build", "the robots keep what they have; save the file again when it is corrected"),
    ]
    with desk.expecting(lambda: desk.session.generation == 1):
        desk.dockerfile.write_text("FROM y")
