from __future__ import annotations

import getpass
import io
import json
import socket
from typing import TYPE_CHECKING

import pytest

from fleet.cli.console import Screen
from fleet.cli.execute import execute, refuse, whoami
from fleet.errors import NotReady
from fleet.plan.step import Bytes, ImageArchive, Plan, Step
from tests.support.homes import Home, start
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from fleet.cli.execute import Planner
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from tests.support.sshd import Sshds


@pytest.fixture
def screen() -> Screen:
    made = Screen()
    for console in (made.out, made.err):
        console.file = io.StringIO()
    return made


@pytest.fixture
def home(sshds: Sshds) -> Home:
    return start(sshds, "pi1")


@pytest.fixture
def away(home: Home) -> Robot:
    return home.robot.model_copy(update={"name": "pi2", "port": free_port()})


def touch(robot: Robot, facts: Facts) -> list[Plan]:
    """Make a file in the robot's home; a robot that has none of ours is refused."""
    if not facts.login.name:
        raise NotReady("nobody is there")
    feed = Bytes(label="bytes", data=b"12345")
    step = Step(title="write it", argv=("sh", "-c", "cat > made"), feed=feed)
    return [Plan(robot=robot.name, summary="make a file", steps=(step,))]


def unchanged(robot: Robot, _: Facts) -> list[Plan]:
    return [Plan(robot=robot.name, summary="has it")]


def text(screen: Screen) -> tuple[str, str]:
    assert isinstance(screen.out.file, io.StringIO)
    assert isinstance(screen.err.file, io.StringIO)
    return screen.out.file.getvalue(), screen.err.file.getvalue()


def test_look_plan_do_and_tell(home: Home, away: Robot, screen: Screen) -> None:
    """One robot is done, the other is away: both are told, and the code is 1."""
    assert execute([home.robot, away], touch, dry=False, json=False, screen=screen) == 1
    assert (home.path / "made").read_bytes() == b"12345"
    out, err = text(screen)
    first, second, cure = out.splitlines()
    assert first.startswith("pi1  done         make a file, sent 5 B, ")
    assert second == f"pi2  unreachable  127.0.0.1 refuses connections to port {away.port}"
    assert "cure: " in cure
    assert "2 robots: look at the robot\n" in err
    assert "pi1: write it (5 B)\n" in err
    assert err.endswith("1 done, 1 unreachable\n")


def test_a_dry_run_shows_the_plan_and_touches_nothing(home: Home, screen: Screen) -> None:
    """The very commands, and a robot that stays as it was."""
    assert execute([home.robot], touch, dry=True, json=False, screen=screen) == 0
    assert list(home.path.iterdir()) == []
    out, err = text(screen)
    assert (
        out == "pi1: make a file, sends 5 B\n  1. write it\n     $ sh -c 'cat > made'   # reads bytes, 5 B\n"
    )
    assert err.endswith("nothing was changed (--dry)\n")


def test_a_dry_run_tells_who_cannot_be_planned_for(home: Home, away: Robot, screen: Screen) -> None:
    """Plans first, in order, then the problems, and the code is 1."""
    assert execute([away, home.robot], touch, dry=True, json=False, screen=screen) == 1
    out, _ = text(screen)
    assert out.startswith("pi1: make a file, sends 5 B\n")
    assert "pi2  unreachable" in out


def test_results_as_json(home: Home, away: Robot, screen: Screen, capsys: pytest.CaptureFixture[str]) -> None:
    """Standard output is JSON alone, done or dry."""
    assert execute([home.robot, away], touch, dry=False, json=True, screen=screen) == 1
    done, gone = json.loads(capsys.readouterr().out)
    assert (done["robot"], done["status"], done["sent"]) == ("pi1", "done", 5)
    assert (gone["robot"], gone["status"]) == ("pi2", "unreachable")
    assert execute([home.robot, away], touch, dry=True, json=True, screen=screen) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["plans"][0]["steps"][0]["argv"] == ["sh", "-c", "cat > made"]
    assert [problem["robot"] for problem in said["problems"]] == ["pi2"]
    assert text(screen)[0] == ""


def test_a_robot_that_is_as_asked_is_unchanged(home: Home, screen: Screen) -> None:
    """Nothing is done, and that is good."""
    assert execute([home.robot], unchanged, dry=False, json=False, screen=screen) == 0
    assert text(screen)[0] == "pi1  unchanged    has it\n"


def test_a_planner_that_refuses_fails_its_robot(home: Home, screen: Screen) -> None:
    """With its reason and cure."""

    def refuse(_: Robot, __: Facts) -> list[Plan]:
        raise NotReady("Docker is not installed", cure="`fab provision`")

    assert execute([home.robot], refuse, dry=False, json=False, screen=screen) == 1
    assert text(screen)[0] == "pi1  failed       Docker is not installed\n       cure: `fab provision`\n"


def climbing(tries: list[str], *scripts: str) -> list[Planner]:
    """One planner for each script, which remembers that it was asked."""

    def rung(script: str) -> Planner:
        def make(robot: Robot, facts: Facts) -> list[Plan]:
            tries.append(script)
            if script == "refuse":
                raise NotReady("there is no room")
            assert facts.login.name
            step = Step(title="try", argv=("sh", "-c", script), harmless=True)
            return [Plan(robot=robot.name, summary=f"by {script}", steps=(step,))]

        return make

    return [rung(script) for script in scripts]


@pytest.mark.parametrize(
    ("scripts", "tried", "code", "says"),
    [
        (("true", "exit 65"), 1, 0, "pi1  done         by true"),
        (("exit 65", "true"), 2, 0, "pi1  done         by true"),
        (("exit 65", "echo no >&2; exit 65", "true"), 3, 0, "pi1  done         by true"),
        (("exit 65", "echo no >&2; exit 65"), 2, 1, "pi1  failed       try: no"),
        (("exit 65", "exit 1", "true"), 2, 1, "pi1  failed       try: `sh` ended with code 1"),
        (("exit 1", "true"), 1, 1, "pi1  failed       try: `sh` ended with code 1"),
        (("exit 65", "refuse", "true"), 2, 1, "pi1  failed       there is no room"),
        (("refuse", "true"), 1, 1, "pi1  failed       there is no room"),
    ],
)
def test_where_one_way_is_unusable_the_next_one_is_tried(
    home: Home, screen: Screen, scripts: tuple[str, ...], tried: int, code: int, says: str
) -> None:
    """Only then, one after the other, and what is told is what became of the last."""
    tries: list[str] = []
    assert execute([home.robot], *climbing(tries, *scripts), dry=False, json=False, screen=screen) == code
    assert tries == list(scripts[:tried])
    out, err = text(screen)
    assert out.startswith(says)
    assert err.count("; trying another way") == tried - 1


def test_each_way_is_planned_for_the_robot_as_it_is_then(home: Home, screen: Screen) -> None:
    """What the first way has changed there, the second one sees."""
    seen: list[tuple[str, ...]] = []

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        seen.append(tuple(facts.fleet.stacks))
        step = Step(title="", argv=("sh", "-c", "mkdir -p .fleet/stacks/abc; exit 65"), harmless=True)
        return [Plan(robot=robot.name, summary="", steps=(step,))]

    execute([home.robot], make, make, dry=False, json=False, screen=screen)
    assert seen == [(), ("abc",)]


def test_each_robot_goes_its_own_way(home: Home, sshds: Sshds, screen: Screen) -> None:
    """Where one needs the second way, the other has the first."""
    other = start(sshds, "pi2")
    (other.path / "works").touch()
    ways = climbing([], "test -e works || exit 65", "true")
    assert execute([home.robot, other.robot], *ways, dry=False, json=False, screen=screen) == 0
    first, second = text(screen)[0].splitlines()
    assert first.startswith("pi1  done         by true")
    assert second.startswith("pi2  done         by test -e works")


def test_a_dry_run_shows_the_first_way(home: Home, screen: Screen) -> None:
    """Nothing is sent, so nothing can be unusable."""
    tries: list[str] = []
    assert (
        execute([home.robot], *climbing(tries, "exit 65", "true"), dry=True, json=False, screen=screen) == 0
    )
    assert tries == ["exit 65"]


@pytest.mark.parametrize("images", [False, True])
def test_planners_are_told_of_images_where_they_ask(home: Home, screen: Screen, images: bool) -> None:
    """It takes longer, and most verbs do without."""
    python: list[bool] = []

    def make(robot: Robot, facts: Facts) -> list[Plan]:
        python.append(facts.fleet.image_store.python)
        return [Plan(robot=robot.name, summary="")]

    execute([home.robot], make, dry=False, json=False, screen=screen, images=images)
    assert python == [images]


def test_only_bytes_that_a_plan_holds_need_no_opener() -> None:
    """A verb that sends images and forgets to open them is a bug."""
    with pytest.raises(TypeError, match="image x needs a sender"):
        refuse(ImageArchive(image="x", reference="x", size=1))


def test_who_is_at_the_desktop() -> None:
    """For the robots' histories."""
    assert whoami() == f"{getpass.getuser()}@{socket.gethostname()}"
