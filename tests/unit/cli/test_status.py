from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.cli import status
from fleet.errors import CommandFailed, FleetError, Unreachable
from fleet.plan.outcome import Outcome
from fleet.robot.facts import Dev, StackFacts
from fleet.robot.history import Event
from tests.support.samples import NOW, change, container, facts

if TYPE_CHECKING:
    from fleet.robot.facts import Container, Facts

GONE = Unreachable("pi1.local did not answer within 10 s", cure="does it have power?")
WELL = facts(current="abc", releases=("abc",), containers=(container("abc"),), services=("talker",))


def cells(seen: Facts | FleetError) -> dict[str, tuple[str, str]]:
    return dict(zip(status.COLUMNS, status.rows("pi1", seen)[0], strict=True))


def test_a_robot_that_is_well() -> None:
    """One row tells all that one asks first."""
    assert cells(change(WELL, temperature=54.3)) == {
        "robot": ("pi1", "bold"),
        "reachable": ("yes", "green"),
        "stack": ("talker", ""),
        "release": ("abc", ""),
        "containers": ("talker healthy 3 min", "green"),
        "data": ("", ""),
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


@pytest.mark.parametrize("kind", ["podman", "rootless", "snap"])
def test_another_engine_is_not_shown_as_docker(kind: str) -> None:
    """It answers with a version too."""
    assert cells(change(facts(), docker_kind=kind))["docker"] == (f"{kind}, not usable", "red")


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (container("abc"), "talker healthy 3 min"),
        (container("abc", health=""), "talker running 3 min"),
        (container("abc", health="unhealthy"), "talker unhealthy 3 min"),
        (container("abc", health="starting", since=NOW - 2), "talker starting 2 s"),
        (container("abc", state="exited"), "talker exited with code 1 3 min ago"),
        (container("abc", state="exited", code=0, policy="no"), "talker completed 3 min ago"),
        (container("abc", state="exited", code=0), "talker exited with code 0 3 min ago"),
        (container("abc", state="restarting", restarts=4), "talker restarting 3 min (restarted 4 times)"),
        (container("abc", restarts=1), "talker healthy 3 min (restarted once)"),
        (container("old"), "talker healthy 3 min of release old"),
        (container("abc", since=0.0), "talker healthy"),
    ],
)
def test_a_container_in_a_few_words(one: Container, words: str) -> None:
    """Its state and for how long, and whatever is not as it should be."""
    assert cells(change(WELL, containers=(one,)))["containers"][0] == words


def test_several_containers_share_a_cell_and_its_colour() -> None:
    """One that is ill makes the cell red, and so does a service without a container, or a swap that goes on."""
    both = (container("abc"), container("abc", service="camera", state="exited"))
    assert cells(change(WELL, containers=both))["containers"] == (
        "talker healthy 3 min, camera exited with code 1 3 min ago",
        "red",
    )
    assert cells(change(WELL, services=("talker", "camera")))["containers"] == (
        "talker healthy 3 min, camera has no container",
        "red",
    )
    assert cells(change(WELL, journal="swap ship def abc 2026"))["containers"] == (
        "talker healthy 3 min, a swap is under way (swap ship def)",
        "red",
    )


def test_who_has_a_robot_in_dev() -> None:
    """Beside the release whose containers have the files; a robot in dev can be well."""
    seen = change(WELL, dev=Dev(by="tim@desktop", since="2026-11-28T12:00:00Z"))
    assert cells(seen)["release"] == ("abc, dev by tim@desktop since 2026-11-28 12:00:00 UTC", "yellow")
    assert status.good(seen)


def test_each_stack_has_a_row_and_the_size_of_its_data() -> None:
    """The robot itself is told once."""
    seen = change(WELL, data=5_000_000)
    stacks = {**seen.fleet.stacks, "other": StackFacts(current="def", data=None)}
    first, second = status.rows("pi1", replace(seen, fleet=replace(seen.fleet, stacks=stacks)))
    assert (first[2][0], first[5][0], first[6][0]) == ("talker", "5.0 MB", "28.0.4")
    assert (second[0], second[2], second[5], second[6]) == (
        ("pi1", "dim"),
        ("other", ""),
        ("large", ""),
        ("", ""),
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
        (change(WELL, services=("talker", "camera")), False),
        (change(WELL, journal="swap"), False),
        (change(WELL, containers=(container("abc", restarts=3, since=NOW - 5),)), False),
        (change(WELL, containers=(container("abc", restarts=3),)), True),
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
    assert record["fleet"]["stacks"]["talker"]["current"] == "abc"
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
        (
            "talker",
            Event(when="2026-11-23T12:00:00Z", verb="ship", release="abc", by="tim@desktop", outcome="done"),
        ),
        (
            "talker",
            Event(
                when="2026-11-23T12:05:00Z",
                verb="ship",
                release="def",
                by="tim@desktop",
                outcome="failed: the robot's disk is full",
            ),
        ),
    )
    rows = [dict(zip(status.EVENT_COLUMNS, status.event_row("pi1", *event), strict=True)) for event in told]
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


def test_rows_come_as_robots_answer_and_the_silent_ones_last() -> None:
    """What was shown never changes; of those that come together the inventory's order counts."""
    seen: dict[str, Facts | FleetError] = {"pi3": WELL, "pi2": GONE}
    arrivals = status.Arrivals(["pi1", "pi2", "pi3", "pi4"], seen)

    def names() -> list[str]:
        return [row[0][0] for row in arrivals.rows()]

    assert names() == ["pi3"]
    seen |= {"pi4": WELL, "pi1": WELL}
    assert names() == names() == ["pi3", "pi1", "pi4"]
    arrivals.over = True
    assert names() == names() == ["pi3", "pi1", "pi4", "pi2"]
    assert [row[0][0] for row in status.table(["pi1", "pi2", "pi9"], seen)] == ["pi1", "pi2"]


@pytest.mark.parametrize(
    ("seen", "total"),
    [
        ([], "0 robots: "),
        ([WELL], "1 robot: 1 well"),
        ([WELL, GONE, change(WELL, current="other")], "3 robots: 1 well, 1 not well, 1 not reachable"),
        ([GONE, GONE], "2 robots: 2 not reachable"),
    ],
)
def test_the_total(seen: list[Facts | FleetError], total: str) -> None:
    """At the end, after all rows."""
    assert status.total({f"pi{number}": one for number, one in enumerate(seen)}) == total


def test_a_jetson_shows_its_linux() -> None:
    """Which images fit depends on it."""
    assert cells(change(WELL, l4t="36.4.0"))["docker"] == ("28.0.4 (L4T 36.4.0)", "")


def test_what_waits_for_a_reboot() -> None:
    """A line for each such robot."""
    seen: dict[str, Facts | FleetError] = {
        "pi1": change(WELL, reboot_for=("i2c", "spi")),
        "pi2": WELL,
        "pi3": GONE,
    }
    assert list(status.reboots(seen)) == ["pi1 has to be rebooted to switch on i2c, spi"]


def test_what_a_robot_is_and_has() -> None:
    """In words for people; what is not known is left out."""
    jetson = change(
        WELL,
        model="NVIDIA Jetson Orin Nano",
        l4t="36.4.0",
        raw_table=False,
        runtimes=("io.containerd.runc.v2", "nvidia", "runc"),
        devices=("/dev/ttyUSB0", "/dev/video0"),
    )
    assert status.described(jetson) == {
        "board": "NVIDIA Jetson Orin Nano",
        "system": "Debian GNU/Linux 13 (trixie)",
        "machine": "aarch64",
        "l4t": "36.4.0",
        "docker": "28.0.4",
        "runtimes": "nvidia, runc",
        "raw table": "no (Docker 28 and newer need it)",
        "groups": "pi, sudo, docker",
        "devices": "/dev/ttyUSB0, /dev/video0",
    }


@pytest.mark.parametrize(
    ("by", "came", "shown"),
    [
        ("tim@desktop", "ssh", "abc"),
        ("tim@desktop by registry through SSH", "registry through SSH", "abc, by registry through SSH"),
        ("tim@desktop by registry 10.0.0.5:5000", "registry 10.0.0.5:5000", "abc, by registry 10.0.0.5:5000"),
        ("pi by stick of 2026-11-28T10:00:00Z", "stick", "abc, by stick"),
    ],
)
def test_how_a_release_came(by: str, came: str, shown: str) -> None:
    """The last ship of it says that; a ship that failed, and a rollback, say nothing."""
    lines = (
        f"2026-11-28T10:00:00Z\tship\tabc\t{by}\tdone",
        "2026-11-28T11:00:00Z\tship\tabc\tann@laptop by stick of x\tfailed: x",
        "2026-11-28T12:00:00Z\trollback\tabc\tann@laptop\tdone",
    )
    seen = change(WELL, history=lines)
    assert cells(seen)["release"][0] == shown
    assert status.record(seen)["fleet"]["stacks"]["talker"]["came"] == came
    assert status.record(WELL)["fleet"]["stacks"]["talker"]["came"] == ""
