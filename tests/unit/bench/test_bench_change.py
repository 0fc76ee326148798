"""How the runs of a changed line are read and told, from values."""

from __future__ import annotations

import pytest

from bench import change, change_page
from bench.change import Measured, Scene, Timeline

ONE = Scene(title="1 robot", stack="small", robots=1)
LARGE = Scene(title="large", stack="large", robots=1)
STEPS = ("begin", "probe", "out of Docker", "bytes", "load", "stop", "start", "first message", "done")


def timeline(total: float, *, build: float = 1.0) -> Timeline:
    """All parts equally long; ``total`` seconds after the build."""
    return Timeline(
        ends={"build": build, **{name: build + total * (n + 1) / len(STEPS) for n, name in enumerate(STEPS)}}
    )


LIMIT = Timeline(
    ends={"build": 0.0, "load": 0.1, "stop": 1.2, "start": 1.4, "first message": 2.7, "done": 3.0}
)


def measured(*, fab: float, save: float, registry: float, scene: Scene = ONE) -> Measured:
    runs = {
        "limit": [LIMIT],
        "fab": [timeline(fab)],
        "save": [timeline(save)],
        "registry": [timeline(registry)],
    }
    return Measured(
        scenes=(scene,),
        runs={(scene.title, way): run for way, run in runs.items()},
        sizes={"small": 212_000_000},
    )


def test_the_lines_of_a_ship_tell_when_its_parts_ended() -> None:
    """Those of one robot, and the one that is for all."""
    lines = [
        (1.0, "2 robots: look at the robot\n"),
        (2.0, "pi1: prepare what it lacks\n"),
        (2.5, "pi2: prepare what it lacks\n"),
        (3.0, "pi1: lacks 1 of 4 layers\n"),
        (3.1, "pi1: write release 0a to ~/.fleet (5.1 kB)\n"),
        (4.0, "pi1: load the image into Docker\n"),
        (5.0, "pi1: start release 0a of talker\n"),
        (9.0, "pi1: done after 9 s\n"),
    ]
    parts = {"begin": 1.0, "probe": 2.0, "out of Docker": 3.1, "bytes": 4.0, "load": 5.0}
    assert change.told(lines, "pi1") == parts
    assert change.told([(0.5, "pi1: look at the robot\n"), *lines[1:2]], "pi1") == {
        "begin": 0.5,
        "probe": 2.0,
    }


def test_a_part_that_a_way_cannot_tell_is_in_the_next() -> None:
    """Nothing is lost: the parts make up the whole."""
    assert LIMIT.parts == pytest.approx(
        {"build": 0.0, "load": 0.1, "stop": 1.1, "start": 0.2, "first message": 1.3, "done": 0.3}
    )
    assert LIMIT.least == pytest.approx(2.6)
    assert LIMIT.shipped == 3.0


@pytest.mark.parametrize(
    ("fab", "save", "registry", "scene", "verdicts"),
    [
        (4.5, 13.6, 4.6, ONE, ["yes", "yes", "yes"]),
        (4.7, 14.0, 4.0, ONE, ["NO", "NO", "NO"]),
        (4.5, 13.6, 4.6, LARGE, ["yes", "NO", "yes"]),
        (4.5, 23.0, 4.6, LARGE, ["yes", "yes", "yes"]),
    ],
)
def test_a_ship_is_held_against_the_limit_and_the_usual_ways(
    fab: float, save: float, registry: float, scene: Scene, verdicts: list[str]
) -> None:
    """Two seconds beyond the limit; three times as fast as `docker save`, five for a large image; no slower than a pull."""
    rows = change_page.goals(measured(fab=fab, save=save, registry=registry, scene=scene))
    assert [row.cells()[3] for row in rows] == verdicts


def test_the_page_has_a_line_for_each_way() -> None:
    """The limit only has what is of the limit."""
    page = change_page.page(measured(fab=4.5, save=13.6, registry=4.6), when="today", machine="The computer.")
    lines = [line for line in page.splitlines() if line.startswith("| 1 robot | ")]
    assert lines[0].endswith("|  |  |  |  |  |  | 1.1 | 0.2 | 1.3 |  | 2.6 |")
    assert [line.rpartition("| ")[2] for line in lines] == ["2.6 |", "4.5 |", "13.6 |", "4.6 |"]


def test_docker_tells_when_containers_stopped_and_started() -> None:
    """The old one's last end counts, and the new one's start; its log has the first message."""
    text = """\
1795866236000000000 kill old
1795866236900000000 kill old
1795866237100000000 die old
1795866237200000000 destroy old
1795866237300000000 start new
1795866237400000000 exec_create new
1795866238400000000 die new
now new
2026-11-28T11:43:59.500000000Z [INFO] hello"""
    ends = change.read_events(text)
    assert ends == {
        "stopping": 1795866236.0,
        "stop": 1795866237.1,
        "start": 1795866237.3,
        "first message": 1795866239.5,
    }


def test_a_run_that_ended_early_says_so() -> None:
    """And tells what it has."""
    some = measured(fab=4.5, save=13.6, registry=4.6)
    some.scenes = (*some.scenes, LARGE)
    some.unfinished = "not done after 9 s"
    page = change_page.page(some, when="today", machine="The computer.")
    assert "\n\nThis run ended early, not done after 9 s.\n\n" in page
    assert "| large |" not in page
