from __future__ import annotations

import pytest

from fleet.errors import NotAsPlanned, Unreachable
from fleet.plan.describe import lines
from fleet.plan.outcome import Outcome, Status, exit_code, failure
from fleet.plan.step import Bytes, ImageArchive, Plan, Record, Step
from fleet.units import human_bytes, human_seconds

RECORD = Record(verb="ship", release="3f2a9c1b5d0e", by="tim@desktop")


def test_a_plan_reads_as_commands_one_could_type() -> None:
    """``--dry`` shows each step, what its command reads, and what follows a failure, quoted as a shell needs it."""
    plan = Plan(
        robot="pi1",
        summary="release 3f2a9c1b5d0e",
        steps=(
            Step(
                title="write it",
                argv=("sh", "-c", 'cat > "$1"', "sh", "a b"),
                feed=Bytes(label="2 files", data=b"x" * 1500),
            ),
            Step(
                title="load talker",
                argv=("docker", "load"),
                feed=ImageArchive(image="talker", reference="talker:fleet-1", size=242_000_000),
            ),
        ),
        explain=(Step(title="show the last log lines", argv=("docker", "logs")),),
        recover=(Step(title="start release 0", argv=("docker", "compose", "up")),),
        record=RECORD,
    )
    assert lines(plan) == [
        "pi1: release 3f2a9c1b5d0e, sends 242 MB",
        "  1. write it",
        """     $ sh -c 'cat > "$1"' sh 'a b'   # reads 2 files, 1.5 kB""",
        "  2. load talker",
        "     $ docker load   # reads image talker:fleet-1, 242 MB",
        "  if a step fails: show the last log lines",
        "     $ docker logs",
        "  if a step fails: start release 0",
        "     $ docker compose up",
        "  at the end: one line into ~/.fleet/history",
    ]


def test_a_plan_without_steps_reads_as_unchanged() -> None:
    """A robot that is as it should be gets one line, and none into its history."""
    assert lines(Plan(robot="pi1", summary="runs release 1", record=RECORD)) == [
        "pi1: unchanged, runs release 1"
    ]


def test_a_plan_knows_how_much_it_sends() -> None:
    """The bytes of all feeds count, those of commands without one do not."""
    feeds = (Bytes(label="files", data=b"12345"), None, ImageArchive(image="a", reference="a", size=1000))
    steps = tuple(Step(title="", argv=("true",), feed=feed) for feed in feeds)
    assert Plan(robot="pi1", summary="", steps=steps).size == 1005


def test_an_error_as_an_outcome() -> None:
    """Only what was never reached is unreachable."""
    assert failure("pi1", Unreachable("away", cure="look")) == Outcome(
        robot="pi1", status="unreachable", reason="away", cure="look"
    )
    assert failure("pi1", NotAsPlanned("odd")).status == "failed"


@pytest.mark.parametrize(
    ("statuses", "code"),
    [
        ((), 0),
        (("done", "unchanged"), 0),
        (("done", "failed"), 1),
        (("unreachable", "done"), 1),
        (("skipped",), 1),
    ],
)
def test_the_exit_code_is_0_only_if_every_robot_is_as_asked(statuses: tuple[Status, ...], code: int) -> None:
    """One robot that failed, was not reached or was left out is enough for a 1."""
    assert exit_code(tuple(Outcome(robot="pi1", status=status) for status in statuses)) == code


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (0, "0 B"),
        (7, "7 B"),
        (999, "999 B"),
        (1000, "1.0 kB"),
        (9_940, "9.9 kB"),
        (9_960, "10 kB"),
        (999_400, "999 kB"),
        (999_600, "1.0 MB"),
        (241_700_000, "242 MB"),
        (999_999_999, "1.0 GB"),
        (32_000_000_000, "32.0 GB"),
        (2_000_000_000_000, "2000.0 GB"),
    ],
)
def test_bytes_as_people_say_them(count: int, said: str) -> None:
    """Decimal units, one digit after the point below ten, and never ``1000 kB``."""
    assert human_bytes(count) == said


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0, "0 s"),
        (0.4, "0 s"),
        (119, "119 s"),
        (120, "2 min"),
        (7199, "120 min"),
        (7200, "2 h"),
        (172_799, "48 h"),
        (172_800, "2 d"),
    ],
)
def test_spans_as_people_say_them(seconds: float, said: str) -> None:
    """A unit is used from two of it on: nobody says ``1 min`` of 90 seconds."""
    assert human_seconds(seconds) == said
