from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.cli import status
from fleet.errors import CommandFailed, FleetError, Unreachable
from fleet.plan.outcome import Outcome
from fleet.robot.history import Event
from tests.support.samples import change, container, facts

if TYPE_CHECKING:
    from fleet.robot.facts import Container, Facts

GONE = Unreachable("pi1.local did not answer within 10 s", cure="does it have power?")
WELL = facts(current="abc", releases=("abc",), containers=(container("abc"),))


def cells(seen: Facts | FleetError) -> dict[str, tuple[str, str]]:
    return dict(zip(status.COLUMNS, status.row("pi1", seen), strict=True))


def test_a_robot_that_is_well() -> None:
    """One row tells all that one asks first."""
    assert cells(change(WELL, temperature=54.3)) == {
        "robot": ("pi1", "bold"),
        "reachable": ("yes", "green"),
        "release": ("abc", ""),
        "containers": ("talker healthy 3 minutes", "green"),
        "docker": ("28.0.4", ""),
        "disk free": ("20.0 GB (62%)", ""),
        "temp": ("54 °C", ""),
    }


def test_a_robot_that_does_not_answer() -> None:
    """Its row has the reason where its containers would be."""
    row = cells(GONE)
    assert (row["reachable"], row["containers"]) == (("no", "bold red"), (GONE.what, "red"))
    assert {row[column] for column in ("release", "docker", "disk free", "temp")} == {("", "")}


def test_a_robot_to_which_nothing_was_shipped() -> None:
    """Blank is not broken."""
    row = cells(change(facts(), docker_state="absent", docker_version=""))
    assert row["release"] == ("none", "dim")
    assert row["containers"] == ("none", "dim")
    assert row["docker"] == ("absent", "red")


@pytest.mark.parametrize(
    ("one", "said"),
    [
        (container("abc"), "talker healthy 3 minutes"),
        (container("abc", status="Up 3 minutes"), "talker running 3 minutes"),
        (container("abc", status="Up About a minute (unhealthy)"), "talker unhealthy a minute"),
        (container("abc", status="Up 2 seconds (health: starting)"), "talker starting 2 seconds"),
        (container("abc", state="exited"), "talker Exited (1) 5 seconds ago"),
        (
            container("abc", state="restarting", status="Restarting (1) 2 seconds ago"),
            "talker Restarting (1) 2 seconds ago",
        ),
        (container("old"), "talker healthy 3 minutes of release old"),
        (container("old", state="exited"), "talker Exited (1) 5 seconds ago of release old"),
    ],
)
def test_a_container_in_a_few_words(one: Container, said: str) -> None:
    """Docker's own sentence without its filling; a release that is not the current one is named."""
    assert cells(change(WELL, containers=(one,)))["containers"][0] == said


def test_several_containers_share_a_cell_and_its_colour() -> None:
    """One that is ill makes the cell red."""
    both = (container("abc"), container("abc", service="camera", state="exited"))
    assert cells(change(WELL, containers=both))["containers"] == (
        "talker healthy 3 minutes, camera Exited (1) 5 seconds ago",
        "red",
    )


@pytest.mark.parametrize(
    ("seen", "well"),
    [
        (WELL, True),
        (facts(), True),
        (change(WELL, containers=()), False),
        (change(WELL, containers=(container("old"),)), False),
        (change(WELL, containers=(container("abc"), container("abc", state="exited"))), False),
        (change(WELL, current=""), False),
        (GONE, False),
    ],
)
def test_well_is_what_was_sent_running_and_nothing_else(seen: Facts | FleetError, well: bool) -> None:
    """The exit code of `fab status` rests on it."""
    assert status.good(seen) is well


@pytest.mark.parametrize(
    ("celsius", "cell"),
    [
        (None, ("", "")),
        (0.0, ("0 °C", "")),
        (69.9, ("70 °C", "")),
        (70.0, ("70 °C", "yellow")),
        (80.0, ("80 °C", "red")),
    ],
)
def test_heat_has_a_colour(celsius: float | None, cell: tuple[str, str]) -> None:
    """A Pi slows down from 80 °C; one without a sensor has no cell."""
    assert cells(change(WELL, temperature=celsius))["temp"] == cell


@pytest.mark.parametrize(
    ("free", "size", "cell"),
    [
        (3_200_000_000, 32_000_000_000, ("3.2 GB (10%)", "")),
        (3_100_000_000, 32_000_000_000, ("3.1 GB (10%)", "red")),
        (0, 32_000_000_000, ("0 B (0%)", "red")),
        (0, 0, ("", "")),
    ],
)
def test_a_disk_that_fills_has_a_colour(free: int, size: int, cell: tuple[str, str]) -> None:
    """Below a tenth it is red; a robot that does not tell has no cell."""
    assert cells(change(WELL, disk_free=free, disk_size=size))["disk free"] == cell


def test_a_robots_state_for_programs() -> None:
    """All facts but the images' long identities, and whether it is well."""
    record = status.record(WELL)
    assert record["reachable"] is True
    assert record["healthy"] is True
    assert record["fleet"]["current"] == "abc"
    assert "images" not in record["fleet"]
    assert status.record(GONE) == {"reachable": False, "reason": GONE.what, "cure": GONE.cure}


LINES = (
    "2026-11-23T12:00:00Z\tship\tabc\ttim@desktop\tdone",
    "garbage",
    "2026-11-23T12:05:00Z\tship\tdef\ttim@desktop\tfailed: the robot's disk is full",
)


def test_a_robots_history_as_events_and_rows() -> None:
    """Oldest first; a failure is red and has its reason."""
    told = status.events(facts(history=LINES))
    assert told == (
        Event(when="2026-11-23T12:00:00Z", verb="ship", release="abc", by="tim@desktop", outcome="done"),
        Event(
            when="2026-11-23T12:05:00Z",
            verb="ship",
            release="def",
            by="tim@desktop",
            outcome="failed: the robot's disk is full",
        ),
    )
    rows = [dict(zip(status.EVENT_COLUMNS, status.event_row("pi1", event), strict=True)) for event in told]
    assert rows[0]["when (UTC)"] == ("2026-11-23 12:00:00", "")
    assert [row["outcome"] for row in rows] == [
        ("done", "green"),
        ("failed: the robot's disk is full", "red"),
    ]
    assert status.events(GONE) == ()


def test_only_robots_that_could_not_be_asked_are_problems() -> None:
    """Unreachable is told apart from the rest."""
    broken = CommandFailed("`sh` ended with code 1", code=1)
    assert status.problems({"pi1": WELL, "pi2": GONE, "pi3": broken}) == (
        Outcome(robot="pi2", status="unreachable", reason=GONE.what, cure=GONE.cure),
        Outcome(robot="pi3", status="failed", reason="`sh` ended with code 1"),
    )
