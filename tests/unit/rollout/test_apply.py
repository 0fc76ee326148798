from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.onboard.exit_codes import UNUSABLE
from fleet.plan.outcome import Outcome
from fleet.plan.step import Bytes, ImageArchive, Plan, Record, Step
from fleet.rollout import reconnect
from fleet.rollout.apply import apply
from fleet.rollout.link import Link
from fleet.rollout.pool import each
from tests.support.homes import Home, Told, start

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from fleet.plan.step import Feed
    from fleet.ssh.session import Stream
    from tests.support.sshd import Sshd, Sshds

    Opener = Callable[[Feed], Iterable[bytes]]

RECORD = Record(verb="ship", release="abc", by="tim@desktop")


@pytest.fixture
def home(sshds: Sshds) -> Home:
    return start(sshds, "pi1")


def sh(
    script: str,
    *,
    title: str = "do",
    harmless: bool = False,
    limit: float = 20.0,
    expect: str | None = None,
    cure: str = "",
) -> Step:
    argv = ("sh", "-c", script)
    return Step(title=title, argv=argv, harmless=harmless, limit=limit, expect=expect, cure=cure)


def open_bytes(feed: Feed) -> Iterable[bytes]:
    assert isinstance(feed, Bytes)
    return (feed.data[:3], feed.data[3:])


def applied(
    home: Home,
    plan: Plan,
    *,
    progress: Told | None = None,
    open_feed: Opener = open_bytes,
    retry_for: float = 20.0,
) -> Outcome:
    link = Link(home.robot)
    try:
        return apply(plan, link, open_feed=open_feed, progress=progress or Told(), retry_for=retry_for)
    finally:
        link.close()


def test_a_plan_is_carried_out_step_by_step(home: Home) -> None:
    """In order, each told as it begins, bytes counted as they leave, and one line of history at the end."""
    steps = (
        Step(title="write", argv=("sh", "-c", "cat > file"), feed=Bytes(label="b", data=b"hello you")),
        sh("cat file", title="prove", expect="hello you\n"),
    )
    told = Told()
    outcome = applied(
        home, Plan(robot="pi1", summary="release abc", steps=steps, record=RECORD), progress=told
    )
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
    assert applied(home, plan, progress=told) == Outcome(
        robot="pi1",
        status="failed",
        step="start it",
        reason="boom\nlast word\nof it\n(went back: start release old)",
    )
    assert [title for _, title, _ in told.began_with] == ["start it", "start release old"]
    assert (home.path / "recovered").exists()
    assert not (home.path / "never").exists()
    assert [line[1:] for line in home.history] == [["ship", "abc", "tim@desktop", "failed: boom"]]


def test_a_long_step_shows_what_it_waits_for(home: Home) -> None:
    """Its lines for a person are shown as they come, and are no part of a proof or a reason."""
    said = "echo 'now: working, 15 s so far'; echo 'note: x is slow'; echo 'now: waits for x'; echo whole"
    told = Told()
    plan = Plan(robot="pi1", summary="", steps=(sh(said, title="install", expect="whole"),))
    assert applied(home, plan, progress=told).status == "done"
    assert told.began_with == [
        ("pi1", "install", None),
        ("pi1", "working, 15 s so far", None),
        ("pi1", "waits for x", None),
    ]
    assert told.said == [("pi1", "x is slow")]
    plan = Plan(robot="pi1", summary="", steps=(sh("echo 'it is broken'; echo 'now: works'; exit 1"),))
    assert applied(home, plan).reason == "it is broken"


def test_what_the_robot_is_asked_after_a_failure_is_diagnosed(home: Home) -> None:
    """systemd says that Docker does not start, its journal says why; the cure is that of the reason, for this verb."""
    line = "unable to configure the Docker daemon with file /etc/docker/daemon.json: no such option: foo"
    plan = Plan(
        robot="pi1",
        summary="",
        verb="provision",
        steps=(sh("echo 'Job for docker.service failed because of x.' >&2; exit 1", title="start Docker"),),
        explain=(sh(f"echo '{line}'"),),
        record=RECORD,
    )
    outcome = applied(home, plan)
    assert outcome.reason == (
        f"Docker does not start: Docker rejects its configuration: no such option: foo\n{line}"
    )
    assert outcome.cure == "fix /etc/docker/daemon.json on the robot, then run the same command again"
    assert home.history[0][-1].endswith("Docker rejects its configuration: no such option: foo")


@pytest.mark.parametrize(
    ("step", "reason", "cure"),
    [
        (sh("echo 'it is broken' >&2; exit 1"), "it is broken", "daemon.json"),
        (sh("echo 'it is broken' >&2; exit 1", cure="mend it"), "it is broken", "daemon.json"),
        (sh("echo 'E: Could not get lock x' >&2; exit 1"), "another program on the robot uses apt", "wait"),
        (sh("echo no", expect="yes"), "the check after this step failed: it printed 'no'", "daemon.json"),
        (sh("echo no", expect="yes", cure="mend it"), "the check after this step failed", "mend it"),
    ],
)
def test_whose_cure_is_told(home: Home, step: Step, reason: str, cure: str) -> None:
    """That of the journal, unless the step itself knew its cause; a proof that failed has no output to search."""
    line = "unable to configure the Docker daemon with file /etc/docker/daemon.json: no such option: foo"
    outcome = applied(home, Plan(robot="pi1", summary="", steps=(step,), explain=(sh(f"echo '{line}'"),)))
    assert outcome.reason.startswith(reason)
    assert line in outcome.reason
    assert cure in outcome.cure


def test_no_cure_names_the_verb_that_runs(home: Home) -> None:
    """`fab provision` cures much, but not itself."""
    step = sh("echo 'E: dpkg was interrupted, you must run x' >&2; exit 1")
    other = applied(home, Plan(robot="pi1", summary="", verb="ship", steps=(step,)))
    itself = applied(home, Plan(robot="pi1", summary="", verb="provision", steps=(step,)))
    assert (other.cure, "dpkg --configure -a" in itself.cure) == ("run `fab provision`", True)


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
        assert (outcome.reason, outcome.cure) == (
            f"the check after this step failed: it printed {said}",
            "run it again",
        )


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
    assert outcome.reason == "`sh` took longer than 1 s and was stopped on the robot\n(went back: back)"
    assert (home.path / "recovered").exists()
    assert home.history[0][-1] == "failed: `sh` took longer than 1 s and was stopped on the robot"
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

    def work(link: Link) -> Outcome:
        return apply(plan, link, open_feed=lambda _: broken(), progress=Told())

    (outcome,) = each([home.robot], work, progress=Told())
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
    link = Link(home.robot)

    class Cutting(Told):
        def step_started(self, robot: str, title: str, size: int | None) -> None:
            super().step_started(robot, title, size)
            if title == "again":
                home.server.stop()

    outcome = apply(
        Plan(robot="pi1", summary="", steps=steps), link, open_feed=open_bytes, progress=Cutting()
    )
    link.close()
    assert (outcome.status, outcome.step) == ("failed", "again")
    assert "refuses connections" in outcome.reason
    assert (tmp_path / "home of pi1/began").exists()


class Away:
    """Takes a robot away each time its file ``began`` grows by a line, and brings it back at the same address, or not."""

    def __init__(self, home: Home, *, times: int, back: bool = True) -> None:
        self._home = home
        self._sshd = home.server
        self._times = times
        self._back = back
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def attempts(self) -> int:
        file = self._home.path / "began"
        return file.read_text().count("\n") if file.exists() else 0

    def _run(self) -> None:
        for time_ in range(1, self._times + 1):
            end = time.monotonic() + 30
            while self.attempts < time_ and time.monotonic() < end:
                time.sleep(0.01)
            self._sshd.stop()
            if self._back:
                self._sshd = self._sshd.again()

    def end(self) -> None:
        self._thread.join()
        self._sshd.stop()


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lost link is tried again sooner than people would want it."""
    monkeypatch.setattr(reconnect, "_PAUSES", (0.1, 0.2))


LASTS = "echo >> began; test $(wc -l < began) -gt 1 || sleep 20; echo through"
"""The first attempt lasts until its link is cut."""


@pytest.mark.usefixtures("hurried")
def test_a_step_that_resumes_goes_on_when_the_robot_is_back(home: Home) -> None:
    """On a new connection, the steps before it not being run again; it is told why it takes longer."""
    away, told = Away(home, times=1), Told()
    steps = (
        sh("echo >> first"),
        replace(sh(LASTS, title="go on", expect="through"), resumes=True),
        sh("echo >> last"),
    )
    outcome = applied(home, Plan(robot="pi1", summary="all", steps=steps, record=RECORD), progress=told)
    away.end()
    assert (outcome.status, outcome.summary) == ("done", "all")
    assert away.attempts == 2
    assert [(home.path / name).read_text() for name in ("first", "last")] == ["\n", "\n"]
    assert [title for _, title, _ in told.began_with if title == "go on"] == ["go on"] * len(told.said) + [
        "go on"
    ]
    (name, text), *_ = told.said
    assert name == "pi1"
    assert text.endswith("; trying again for 20 s")
    assert [line[-1] for line in home.history] == ["done"]


@pytest.mark.usefixtures("hurried")
def test_a_step_that_does_not_resume_is_not_run_again(home: Home) -> None:
    """Whether it can stand that is not known."""
    away, told = Away(home, times=1), Told()
    outcome = applied(home, Plan(robot="pi1", summary="", steps=(sh(LASTS, title="once"),)), progress=told)
    away.end()
    assert (outcome.status, outcome.step, away.attempts) == ("failed", "once", 1)
    assert told.said == []


@pytest.mark.usefixtures("hurried")
def test_a_lost_connection_is_retried_for_so_long_only(home: Home) -> None:
    """A robot that stays away is told as such, and what to do."""
    away = Away(home, times=1, back=False)
    steps = (replace(sh(LASTS, title="go on"), resumes=True), sh("touch never"))
    began = time.monotonic()
    outcome = applied(home, Plan(robot="pi1", summary="", steps=steps), retry_for=0.5)
    away.end()
    assert time.monotonic() - began < 15
    assert (outcome.status, outcome.step, away.attempts) == ("failed", "go on", 1)
    assert "refuses connections" in outcome.reason
    assert outcome.cure
    assert not outcome.unusable


@pytest.mark.usefixtures("hurried")
def test_retrying_counts_from_the_last_byte_that_left(home: Home) -> None:
    """A link that is cut again and again, and carries something each time, is worth waiting for."""
    away = Away(home, times=3)
    goes_on = "cat > got; echo >> began; test $(wc -l < began) -gt 3 || sleep 20"
    step = replace(
        sh(goes_on, title="send"), feed=Bytes(label="b", data=b"hello you"), resumes=True, harmless=True
    )

    def slow(_: Feed) -> Iterator[bytes]:
        time.sleep(0.4)
        yield b"hello you"

    outcome = applied(home, Plan(robot="pi1", summary="", steps=(step,)), open_feed=slow, retry_for=0.9)
    away.end()
    assert (outcome.status, outcome.sent, away.attempts) == ("done", 4 * 9, 4)


@pytest.mark.usefixtures("hurried")
def test_the_history_is_kept_though_the_link_is_lost(home: Home) -> None:
    """Else a rollback would not know of the release; it is written once."""
    history = home.path / ".fleet/history"
    back: list[Sshd] = []

    def cut_while_it_is_read() -> None:
        end = time.monotonic() + 20
        while time.monotonic() < end:
            with contextlib.suppress(OSError):  # until there is a reader
                writer = os.open(history, os.O_WRONLY | os.O_NONBLOCK)
                history.unlink()
                home.server.stop()
                os.close(writer)
                back.append(home.server.again())
                return

    thread = threading.Thread(target=cut_while_it_is_read)
    thread.start()
    plan = Plan(robot="pi1", summary="", steps=(sh("mkdir .fleet && mkfifo .fleet/history"),), record=RECORD)
    told = Told()
    outcome = applied(home, plan, progress=told)
    thread.join()
    back[0].stop()
    assert (outcome.status, len(told.said) > 0) == ("done", True)
    assert [line[-1] for line in home.history] == ["done"]


def test_a_command_that_fails_is_no_lost_link(home: Home) -> None:
    """It would fail again."""
    step = replace(sh("echo >> began; echo boom >&2; exit 1"), resumes=True)
    assert applied(home, Plan(robot="pi1", summary="", steps=(step,))).reason == "boom"
    assert (home.path / "began").read_text() == "\n"


def test_what_comes_afterwards_is_no_part_of_success(home: Home) -> None:
    """It is told as it begins, it runs though the one before failed, and the history knows of none of it."""
    told = Told()
    plan = Plan(
        robot="pi1",
        summary="release abc",
        steps=(sh("true", title="start"),),
        afterwards=(sh("exit 1", title="remove"), sh("touch removed", title="forget")),
        recover=(sh("touch recovered"),),
        record=RECORD,
        forecast="sends nothing",
    )
    assert applied(home, plan, progress=told) == Outcome(robot="pi1", status="done", summary="release abc")
    assert [title for _, title, _ in told.began_with] == ["start", "remove", "forget"]
    assert told.said == [("pi1", "sends nothing")]
    assert (home.path / "removed").exists()
    assert not (home.path / "recovered").exists()
    assert [line[-1] for line in home.history] == ["done"]


def test_nothing_comes_afterwards_where_a_step_failed(home: Home) -> None:
    """The old release may be needed."""
    plan = Plan(robot="pi1", summary="", steps=(sh("exit 1"),), afterwards=(sh("touch removed"),))
    assert applied(home, plan).status == "failed"
    assert not (home.path / "removed").exists()


class Talk:
    """Answers each line that the robot says with the same in capitals, until it says ``bye``."""

    def __init__(self) -> None:
        self.said: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self.closed = False
        self.on_note: Callable[[str], None] = lambda _: None

    def on_output(self, data: bytes) -> None:
        for line in data.splitlines(keepends=True):
            self.said.put(line)

    def close(self) -> None:
        self.closed = True
        self.said.put(b"bye\n")

    def __iter__(self) -> Iterator[bytes]:
        while (line := self.said.get()) != b"bye\n":
            self.on_note(f"it says {line.decode().strip()}")
            yield line.upper()


ASKS = "echo one; read -r first; echo two; read -r second; echo $first $second > got"


@pytest.mark.parametrize(
    ("script", "status"),
    [
        (f"{ASKS}; echo bye", "done"),
        (ASKS, "done"),
        (f"{ASKS}; exit 1", "failed"),
        ("echo one; exit 1", "failed"),
    ],
)
def test_a_conversation(home: Home, script: str, status: str) -> None:
    """What is sent depends on what the robot says; at the end it is closed, whatever the end is."""
    talk, told = Talk(), Told()
    step = sh(script, title="talk")
    plan = Plan(
        robot="pi1",
        summary="",
        steps=(replace(step, feed=ImageArchive(image="talk", reference="talk", size=8)),),
    )
    outcome = applied(home, plan, progress=told, open_feed=lambda _: talk)
    assert (outcome.status, talk.closed) == (status, True)
    assert told.began_with[0] == ("pi1", "talk", 8)
    if "read" in script:
        assert told.began_with[1] == ("pi1", "it says one", None)
        assert (home.path / "got").read_text() == "ONE TWO\n"
        assert outcome.sent >= 4  # the robot may end before the last bytes are counted


class Service(Talk):
    """Tells the robot a port, and answers the one connection that it makes there."""

    def __init__(self) -> None:
        super().__init__()
        self.port = 0
        self.on_served: Callable[[int], None] = lambda _: None

    def begin(self, port: int) -> None:
        self.port = port

    def serve(self, stream: Stream) -> None:
        stream.sendall(stream.recv(100).upper())
        self.on_served(1000)

    def __iter__(self) -> Iterator[bytes]:
        yield f"{self.port}\n".encode()
        yield from super().__iter__()


def test_a_robot_may_connect_to_this_computer(home: Home) -> None:
    """Through SSH, to what feeds its step; bytes that were served are counted, and those of the feed are not."""
    service = Service()
    script = "read -r port; exec 3<>/dev/tcp/127.0.0.1/$port; echo hello >&3; head -n 1 <&3 >got"
    step = replace(
        Step(title="pull", argv=("bash", "-c", script)),
        feed=ImageArchive(image="talk", reference="talk", size=8),
    )
    outcome = applied(home, Plan(robot="pi1", summary="", steps=(step,)), open_feed=lambda _: service)
    assert (outcome.status, outcome.sent, service.closed) == ("done", 1000, True)
    assert (home.path / "got").read_text() == "HELLO\n"


@pytest.mark.usefixtures("hurried")
def test_a_conversation_that_is_cut_is_closed_and_another_one_held(home: Home) -> None:
    """Nobody asks any more, so nobody may wait for questions."""
    away, talks = Away(home, times=1), []

    def open_talk(_: Feed) -> Talk:
        talks.append(Talk())
        return talks[-1]

    step = sh(f"echo one; read -r first; {LASTS}")
    step = replace(step, feed=ImageArchive(image="talk", reference="talk", size=4), resumes=True)
    outcome = applied(home, Plan(robot="pi1", summary="", steps=(step,)), open_feed=open_talk)
    away.end()
    assert outcome.status == "done"
    assert all(talk.closed for talk in talks)
    assert len(talks) >= 2


@pytest.mark.parametrize(
    ("script", "expect", "before", "unusable"),
    [
        (f"exit {UNUSABLE}", None, True, True),
        ("echo no", "yes", True, True),
        ("exit 1", None, True, False),
        ("exit 75", None, True, False),
        ("sleep 20", None, True, False),
        (f"exit {UNUSABLE}", None, False, False),
        ("echo no", "yes", False, False),
    ],
)
def test_what_was_sent_and_cannot_be_used(
    home: Home, script: str, expect: str | None, before: bool, unusable: bool
) -> None:
    """Another way of sending may help: after a code that says so or a proof that fails, and before what runs is touched."""
    steps = (sh("true", harmless=before), sh(script, harmless=True, expect=expect, limit=1.0))
    outcome = applied(home, Plan(robot="pi1", summary="", steps=steps))
    assert (outcome.status, outcome.unusable) == ("failed", unusable)
