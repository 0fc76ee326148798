from __future__ import annotations

import os
import signal
import threading
import time
from typing import TYPE_CHECKING

import pytest
from homes import Home, Told, start, statuses
from samples import PI
from sshd import free_port

from fleet.errors import CommandFailed, DesktopError, LinkLost, NotAsPlanned
from fleet.plan import Bytes, ImageArchive, Outcome, Plan, Record, Step
from fleet.rollout import Line, apply, each

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sshd import Sshds

    from fleet.inventory import Robot
    from fleet.plan import Feed

RECORD = Record(verb="ship", release="abc", by="tim@desktop")


@pytest.fixture
def home(sshds: Sshds) -> Home:
    return start(sshds, "pi1")


def robots(*names: str) -> list[Robot]:
    """Robots that nobody connects to."""
    return [PI.model_copy(update={"name": name}) for name in names]


def done(line: Line) -> Outcome:
    return Outcome(robot=line.robot.name, status="done")


def sh(
    script: str, *, title: str = "do", harmless: bool = False, limit: float = 20.0, expect: str | None = None
) -> Step:
    return Step(title=title, argv=("sh", "-c", script), harmless=harmless, limit=limit, expect=expect)


def open_bytes(feed: Feed) -> Iterable[bytes]:
    assert isinstance(feed, Bytes)
    return (feed.data[:3], feed.data[3:])


def applied(home: Home, plan: Plan, *, watch: Told | None = None) -> Outcome:
    line = Line(home.robot)
    try:
        return apply(plan, line, open_feed=open_bytes, watch=watch or Told())
    finally:
        line.close()


def test_one_robots_failure_is_its_own(sshds: Sshds) -> None:
    """Refused, unknown, unreachable or broken: the others are done, and all are told in the order of the inventory."""
    good, broken, unknown = start(sshds, "pi1"), start(sshds, "pi2"), start(sshds, "pi3", trusted=False)
    away = good.robot.model_copy(update={"name": "pi4", "port": free_port()})
    last = start(sshds, "pi5")
    (good.path / "fine").touch()
    (last.path / "fine").touch()

    def work(line: Line) -> Outcome:
        line.run("ls", "fine")
        return done(line)

    told = Told()
    outcomes = each([good.robot, broken.robot, unknown.robot, away, last.robot], work, watch=told)
    assert statuses(outcomes) == {
        "pi1": "done",
        "pi2": "failed",
        "pi3": "failed",
        "pi4": "unreachable",
        "pi5": "done",
    }
    assert "fine" in outcomes[1].reason
    assert "is not known yet" in outcomes[2].reason
    assert outcomes[3].reason == f"127.0.0.1 refuses connections to port {away.port}"
    assert outcomes[3].cure
    assert {outcome.robot for outcome in told.ended_with} == {"pi1", "pi2", "pi3", "pi4", "pi5"}
    assert all(outcome.seconds > 0 for outcome in outcomes)


def test_no_more_at_once_than_may_be() -> None:
    """A pool: as many as allowed, and never more."""
    lock, full, now, most = threading.Lock(), threading.Barrier(3, timeout=10), [0], [0]

    def work(line: Line) -> Outcome:
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        full.wait()
        with lock:
            now[0] -= 1
        return done(line)

    outcomes = each(robots("a", "b", "c", "d", "e", "f"), work, watch=Told(), at_once=3)
    assert (len(outcomes), most[0]) == (6, 3)


def test_nobody_to_work_for() -> None:
    """No robots, no outcomes, no waiting."""
    assert each([], done, watch=Told()) == ()


def test_a_bug_is_raised_when_the_others_have_ended() -> None:
    """A programmer's mistake must not leave robots half done, nor be swallowed."""
    ended: list[str] = []
    go = threading.Event()

    def work(line: Line) -> Outcome:
        if line.robot.name == "bug":
            go.set()
            raise ZeroDivisionError
        go.wait(10)
        time.sleep(0.1)
        ended.append(line.robot.name)
        return done(line)

    with pytest.raises(ZeroDivisionError):
        each(robots("a", "bug", "b"), work, watch=Told())
    assert sorted(ended) == ["a", "b"]


def test_ctrl_c_ends_all_that_run_and_tells_what_became_of_each(sshds: Sshds) -> None:
    """A robot that is through stays done; connections are closed, and nobody waits for the sleepers."""
    quick, slow, asleep = start(sshds, "pi1"), start(sshds, "pi2"), start(sshds, "pi3")
    closed: list[str] = []

    def work(line: Line) -> Outcome:
        if line.robot.name == "pi1":
            return done(line)
        try:
            line.run("sh", "-c", "touch began; sleep 20", limit=40)
        except LinkLost:
            closed.append(line.robot.name)
            raise
        return done(line)

    def interrupt() -> None:
        while not all((home.path / "began").exists() for home in (slow, asleep)):
            time.sleep(0.01)
        time.sleep(0.1)  # the quick one has long ended
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    began, told = time.monotonic(), Told()
    outcomes = each([slow.robot, quick.robot, asleep.robot], work, watch=told)
    assert time.monotonic() - began < 20
    assert statuses(outcomes) == {"pi2": "skipped", "pi1": "done", "pi3": "skipped"}
    assert outcomes[0].reason == "interrupted by Ctrl-C"
    assert sorted(outcome.robot for outcome in told.ended_with) == ["pi1", "pi2", "pi3"]
    while len(closed) < 2:
        assert time.monotonic() - began < 20
        time.sleep(0.01)


def test_when_nobody_reads_any_more_everything_ends() -> None:
    """`fab logs --follow | head`: the one that notices ends the others, who would follow for ever."""

    def work(line: Line) -> Outcome:
        if line.robot.name == "writer":
            raise BrokenPipeError
        assert line.closed.wait(10)
        return done(line)

    began = time.monotonic()
    with pytest.raises(BrokenPipeError):
        each(robots("a", "writer", "b"), work, watch=Told())
    assert time.monotonic() - began < 8


def test_a_line_connects_once_and_afresh_when_asked(home: Home) -> None:
    """All commands to a robot share a connection; group membership needs a new one."""
    line = Line(home.robot)
    assert home.logins == 0
    assert (line.run("echo", "one"), line.run("echo", "two")) == ("one\n", "two\n")
    assert home.logins == 1
    line.afresh()
    assert line.run("echo", "three") == "three\n"
    assert home.logins == 2
    line.close()
    with pytest.raises(LinkLost, match="interrupted by Ctrl-C"):
        line.run("echo", "four")


def test_a_command_that_fails_is_explained(home: Home) -> None:
    """What it means where that is known, its own last words where not, its name where it said nothing."""
    line = Line(home.robot)
    for script, what in (
        ("echo 'write x: no space left on device' >&2; exit 3", "its disk is full"),
        ("echo 'some new trouble' >&2; exit 3", "some new trouble"),
        ("exit 3", "`sh` ended with code 3"),
    ):
        with pytest.raises(CommandFailed) as caught:
            line.run("sh", "-c", script)
        assert (caught.value.what, caught.value.code) == (what, 3)
    line.close()


def test_the_facts_of_a_robot(sshds: Sshds) -> None:
    """One round trip; what its login scripts print is kept apart."""
    home = start(sshds, "pi1", before="echo Welcome")
    (home.path / ".fleet/releases/abc").mkdir(parents=True)
    line = Line(home.robot)
    seen = line.facts()
    line.close()
    assert (seen.releases, seen.noise, seen.login) == (("abc",), "Welcome", home.robot.user)


def test_a_login_that_runs_no_commands_is_told_so(sshds: Sshds) -> None:
    """A restricted shell answers something else, and exits well."""
    server = sshds.start("pi1", options=("ForceCommand echo only git here >&2",))
    line = Line(server.robot())
    with pytest.raises(NotAsPlanned, match="the robot's shell did not run the probe: only git here"):
        line.facts()
    line.close()


def test_a_plan_is_carried_out_step_by_step(home: Home) -> None:
    """In order, each told as it begins, bytes counted as they leave, and one line of history at the end."""
    steps = (
        Step(title="write", argv=("sh", "-c", "cat > file"), feed=Bytes(label="b", data=b"hello you")),
        sh("cat file", title="prove", expect="hello you\n"),
    )
    told = Told()
    outcome = applied(home, Plan(robot="pi1", summary="release abc", steps=steps, record=RECORD), watch=told)
    assert outcome == Outcome(robot="pi1", status="done", summary="release abc", sent=9)
    assert told.began_with == [("pi1", "write", 9), ("pi1", "prove", None)]
    assert told.bytes == 9
    (line,) = home.history
    assert line[1:] == ["ship", "abc", "tim@desktop", "done"]
    assert line[0].startswith("20")
    assert home.logins == 1


def test_a_plan_without_steps_does_not_even_connect(home: Home) -> None:
    """Unchanged is free, and leaves no line."""
    outcome = applied(home, Plan(robot="pi1", summary="runs release abc", record=RECORD))
    assert outcome == Outcome(robot="pi1", status="unchanged", summary="runs release abc")
    assert (home.logins, home.history) == (0, [])


def test_a_step_that_fails_is_explained_and_what_ran_before_is_started_again(home: Home) -> None:
    """Steps after it do not run; the history says that and why it failed."""
    plan = Plan(
        robot="pi1",
        summary="release abc",
        steps=(sh("echo boom >&2; exit 1", title="start it"), sh("touch never")),
        explain=(sh("printf 'last \\033[31mword\\033[0m\\nof it\\n'"),),
        recover=(sh("touch recovered", title="start release old"),),
        record=RECORD,
    )
    told = Told()
    assert applied(home, plan, watch=told) == Outcome(
        robot="pi1",
        status="failed",
        step="start it",
        reason="boom\nlast word\nof it\n(went back: start release old)",
    )
    assert [title for _, title, _ in told.began_with] == ["start it", "start release old"]
    assert (home.path / "recovered").exists()
    assert not (home.path / "never").exists()
    assert [line[1:] for line in home.history] == [["ship", "abc", "tim@desktop", "failed: boom"]]


def test_a_recovery_that_fails_too_is_told(home: Home) -> None:
    """Both reasons, and nothing is hidden by the second."""
    plan = Plan(
        robot="pi1",
        summary="",
        steps=(sh("echo boom >&2; exit 1"),),
        recover=(sh("echo worse >&2; exit 2", title="start release old"), sh("touch third")),
    )
    assert applied(home, plan).reason == "boom\nand then `start release old` failed: worse\n(went back: do)"
    assert (home.path / "third").exists()
    assert home.history == []


def test_nothing_is_recovered_where_nothing_was_touched(home: Home) -> None:
    """A load that fails leaves alone what runs; only from the first step that is not harmless on is there a way back."""
    back = (sh("touch recovered"),)
    fails = sh("exit 1", harmless=True)
    before = Plan(
        robot="pi1", summary="", steps=(sh("true", harmless=True), fails), explain=back, recover=back
    )
    assert applied(home, before).reason == "`sh` ended with code 1"
    assert not (home.path / "recovered").exists()
    after = Plan(robot="pi1", summary="", steps=(sh("true"), fails), recover=back)
    assert applied(home, after).reason == "`sh` ended with code 1\n(went back: do)"
    assert (home.path / "recovered").exists()


@pytest.mark.parametrize(
    ("script", "expect", "proven"),
    [
        ("echo active", "active", True),
        ("echo ' active '", "active\n", True),
        ("echo one; echo two", "one\ntwo", True),
        ("echo inactive", "active", False),
        ("echo one; echo two", "one", False),
        ("true", "active", False),
    ],
)
def test_a_step_is_believed_by_its_proof_only(home: Home, script: str, expect: str, proven: bool) -> None:
    """Exit code 0 is not enough where an output was promised."""
    step = Step(title="prove", argv=("sh", "-c", script), expect=expect, cure="run it again")
    outcome = applied(home, Plan(robot="pi1", summary="", steps=(step,)))
    assert outcome.status == ("done" if proven else "failed")
    if not proven:
        said = {"echo inactive": "'inactive'", "true": "'nothing'"}.get(script, "'two'")
        assert (outcome.reason, outcome.cure) == (f"the proof fails: it says {said}", "run it again")


def test_a_proof_comes_after_what_login_scripts_print(sshds: Sshds) -> None:
    """A robot that greets is no liar."""
    home = start(sshds, "pi1", before="echo Welcome to pi1")
    assert (
        applied(home, Plan(robot="pi1", summary="", steps=(sh("echo yes", expect="yes"),))).status == "done"
    )


def test_a_step_that_takes_too_long_is_ended_and_recovered_from(home: Home) -> None:
    """On a new connection: the old one may be what hangs."""
    plan = Plan(
        robot="pi1",
        summary="",
        steps=(sh("sleep 20", title="hang", limit=1.0),),
        recover=(sh("touch recovered", title="back"),),
        record=RECORD,
    )
    outcome = applied(home, plan)
    assert (outcome.status, outcome.step) == ("failed", "hang")
    assert outcome.reason == "`sh` took longer than 1 s and was ended on the robot\n(went back: back)"
    assert (home.path / "recovered").exists()
    assert home.history[0][-1] == "failed: `sh` took longer than 1 s and was ended on the robot"
    assert home.logins == 2


def test_a_link_that_is_cut_in_a_step_is_told_with_what_to_do(home: Home) -> None:
    """Nothing is recovered over a link that is gone; the reason says so within seconds."""

    def cut() -> None:
        while not (home.path / "began").exists():
            time.sleep(0.01)
        home.server.stop()

    plan = Plan(
        robot="pi1",
        summary="",
        steps=(sh("touch began; sleep 20", title="start it", limit=40),),
        recover=(sh("touch recovered"),),
    )
    threading.Thread(target=cut).start()
    began = time.monotonic()
    outcome = applied(home, plan)
    assert time.monotonic() - began < 20
    assert (outcome.status, outcome.step) == ("failed", "start it")
    assert "lost" in outcome.reason
    assert "\n" not in outcome.reason
    assert outcome.cure


@pytest.mark.parametrize(("until_closed", "status"), [(True, "done"), (False, "failed")])
def test_a_step_that_ends_with_its_connection_finds_its_input_open(
    home: Home, until_closed: bool, status: str
) -> None:
    """The end of its input is how it learns that nobody is there any more; others read nothing at once."""
    waits = ("sh", "-c", "timeout 0.5 cat; test $? = 124")
    step = Step(title="wait", argv=waits, until_closed=until_closed)
    assert applied(home, Plan(robot="pi1", summary="", steps=(step,))).status == status


def test_a_step_with_a_fresh_login_has_a_connection_of_its_own(home: Home) -> None:
    """So it sees the groups that the step before gave it."""
    fresh = Step(title="", argv=("true",), fresh_login=True)
    assert (
        applied(home, Plan(robot="pi1", summary="", steps=(sh("true"), fresh, sh("true")))).status == "done"
    )
    assert home.logins == 2


def test_bytes_that_cannot_be_had_here_fail_the_robot_and_not_the_program(home: Home) -> None:
    """Docker on the desktop stopped in the middle of an image."""

    def broken() -> Iterable[bytes]:
        yield b"first bytes"
        raise DesktopError("reading image talker from Docker failed: gone", cure="see `docker info`")

    step = Step(
        title="load", argv=("sh", "-c", "cat > got"), feed=ImageArchive(image="a", reference="a", size=100)
    )
    plan = Plan(robot="pi1", summary="", steps=(step, sh("touch never")))

    def work(line: Line) -> Outcome:
        return apply(plan, line, open_feed=lambda _: broken(), watch=Told())

    (outcome,) = each([home.robot], work, watch=Told())
    assert (outcome.status, outcome.reason) == ("failed", "reading image talker from Docker failed: gone")
    assert outcome.cure == "see `docker info`"
    assert not (home.path / "never").exists()


def test_a_history_that_cannot_be_written_is_no_failure(home: Home) -> None:
    """A full disk: what the robot runs matters more."""
    (home.path / ".fleet").write_text("in the way")
    assert applied(home, Plan(robot="pi1", summary="", steps=(sh("true"),), record=RECORD)).status == "done"


def test_a_robot_that_vanishes_before_a_fresh_login_is_told_so(home: Home, tmp_path: Path) -> None:
    """It was reached once, so it has failed at a step."""
    steps = (sh("touch began"), Step(title="again", argv=("true",), fresh_login=True))
    line = Line(home.robot)

    class Cutting(Told):
        def began(self, robot: str, title: str, size: int | None) -> None:
            super().began(robot, title, size)
            if title == "again":
                home.server.stop()

    outcome = apply(Plan(robot="pi1", summary="", steps=steps), line, open_feed=open_bytes, watch=Cutting())
    line.close()
    assert (outcome.status, outcome.step) == ("failed", "again")
    assert "refuses connections" in outcome.reason
    assert (tmp_path / "home of pi1/began").exists()
