from __future__ import annotations

from fleet import onboard
from fleet.plan.describe import details, headline, lines
from fleet.plan.outcome import Outcome
from fleet.plan.step import Bytes, ImageArchive, Plan, Record, Step

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


def test_a_file_for_the_robot_is_shown_by_the_line_that_says_what_it_does() -> None:
    """The text of a script would bury the plan."""
    script = onboard.text("unpack_release.sh")
    plan = Plan(robot="pi1", summary="", steps=(Step(title="write", argv=("sh", "-c", script, "sh", "a b")),))
    assert lines(plan)[2] == (
        "     $ sh -c '# Unpack a release (a tar archive on standard input) into its folder, whole or not at all, and safe from a power cut."
        f" [{len(script.splitlines()) - 2} more lines: --dry --json]' sh 'a b'"
    )


def test_a_long_script_is_shown_by_its_first_line_and_a_short_one_whole() -> None:
    """Scripts of one's own length are read where they stand."""
    plan = Plan(
        robot="pi1",
        summary="",
        steps=(
            Step(title="", argv=("# long\n" + "true\n" * 20,)),
            Step(title="", argv=("# short\ntrue",)),
        ),
    )
    text = lines(plan)
    assert text[2] == "     $ '# long [20 more lines: --dry --json]'"
    assert text[4] == "     $ '# short\ntrue'"


def test_an_outcome_in_one_line() -> None:
    """How long it took is said of work that was done; how the images were sent, where any were."""
    done = Outcome(
        robot="pi1", status="done", summary="release 1", seconds=8.0, sent=1500, transfer="1 layer"
    )
    assert headline(done) == "release 1, sent 1.5 kB (1 layer), 8 s"
    assert headline(Outcome(robot="pi1", status="unchanged", summary="runs 1", seconds=8.0)) == "runs 1"
    assert headline(Outcome(robot="pi1", status="failed", step="load", reason="full\nlog")) == "load: full"
    assert headline(Outcome(robot="pi1", status="unreachable", reason="away")) == "away"


def test_the_rest_of_a_failure_stands_below() -> None:
    """Log lines, then the cure; a robot that is as asked has neither."""
    failed = Outcome(robot="pi1", status="failed", reason="full\nlog", cure="make room")
    assert details(failed) == ["  | log", "  cure: make room"]
    assert details(Outcome(robot="pi1", status="done", reason="a\nb", cure="c")) == []
