from __future__ import annotations

import contextlib
import errno
import os
import resource
import signal
import socket
import threading
import time
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError, LinkLost
from fleet.plan.outcome import Outcome
from fleet.rollout.pool import each
from tests.support.homes import Told, start, statuses
from tests.support.samples import PI
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.rollout.link import Link
    from tests.support.sshd import Sshds


def robots(*names: str) -> list[Robot]:
    """Robots that nobody connects to."""
    return [PI.model_copy(update={"name": name}) for name in names]


def done(link: Link) -> Outcome:
    return Outcome(robot=link.robot.name, status="done")


def test_one_robots_failure_is_its_own(sshds: Sshds) -> None:
    """Refused, unknown, unreachable or broken: the others are done, and all are told in the order of the inventory."""
    good, broken, unknown = start(sshds, "pi1"), start(sshds, "pi2"), start(sshds, "pi3", trusted=False)
    away = good.robot.model_copy(update={"name": "pi4", "port": free_port()})
    last = start(sshds, "pi5")
    (good.path / "fine").touch()
    (last.path / "fine").touch()

    def work(link: Link) -> Outcome:
        link.run("ls", "fine")
        return done(link)

    told = Told()
    outcomes = each([good.robot, broken.robot, unknown.robot, away, last.robot], work, progress=told)
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

    def work(link: Link) -> Outcome:
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        full.wait()
        with lock:
            now[0] -= 1
        return done(link)

    outcomes = each(robots("a", "b", "c", "d", "e", "f"), work, progress=Told(), at_once=3)
    assert (len(outcomes), most[0]) == (6, 3)


def test_robots_that_do_not_answer_keep_no_others_waiting() -> None:
    """Ten accept a connection and say nothing; those after them are done while they are waited for."""
    with contextlib.ExitStack() as holes:
        ports = [
            holes.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1] for _ in range(10)
        ]
        silent = [
            PI.model_copy(update={"name": f"hole{number}", "address": "127.0.0.1", "port": port})
            for number, port in enumerate(ports)
        ]

        def work(link: Link) -> Outcome:
            if link.robot.name.startswith("hole"):
                link.run("true")
            return done(link)

        began, told = time.monotonic(), Told()
        outcomes = each([*silent, *robots("a", "b")], work, progress=told, at_once=2, connect_timeout=3)
    assert time.monotonic() - began < 12  # one after the other: 20
    assert [outcome.robot for outcome in told.ended_with][:2] == ["a", "b"]
    assert {outcome.status for outcome in outcomes[:10]} == {"unreachable"}


def test_too_few_open_files_are_a_robots_failure_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other programs may have taken them meanwhile."""

    def work(_: Link) -> Outcome:
        raise OSError(errno.EMFILE, "Too many open files")

    (outcome,) = each(robots("a"), work, progress=Told())
    assert outcome.status == "failed"
    assert "open files, which are too few" in outcome.reason
    monkeypatch.setattr(resource, "getrlimit", lambda _: (12, 12))
    with pytest.raises(DesktopError, match="allows 12 open files"):
        each(robots("a"), work, progress=Told())


def test_nobody_to_work_for() -> None:
    """No robots, no outcomes, no waiting."""
    assert each([], done, progress=Told()) == ()


def test_a_bug_is_raised_when_the_others_have_ended() -> None:
    """A programmer's mistake must not leave robots half done, nor be swallowed."""
    ended: list[str] = []
    go = threading.Event()

    def work(link: Link) -> Outcome:
        if link.robot.name == "bug":
            go.set()
            raise ZeroDivisionError
        go.wait(10)
        time.sleep(0.1)
        ended.append(link.robot.name)
        return done(link)

    with pytest.raises(ZeroDivisionError):
        each(robots("a", "bug", "b"), work, progress=Told())
    assert sorted(ended) == ["a", "b"]


def test_ctrl_c_ends_all_that_run_and_tells_what_became_of_each(sshds: Sshds) -> None:
    """A robot that is through stays done; connections are closed, and nobody waits for the sleepers."""
    quick, slow, asleep = start(sshds, "pi1"), start(sshds, "pi2"), start(sshds, "pi3")
    closed: list[str] = []

    def work(link: Link) -> Outcome:
        if link.robot.name == "pi1":
            return done(link)
        try:
            link.run("sh", "-c", "touch began; sleep 20", limit=40)
        except LinkLost:
            closed.append(link.robot.name)
            raise
        return done(link)

    def interrupt() -> None:
        while not all((home.path / "began").exists() for home in (slow, asleep)):
            time.sleep(0.01)
        time.sleep(0.1)  # the quick one has long ended
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    began, told = time.monotonic(), Told()
    outcomes = each([slow.robot, quick.robot, asleep.robot], work, progress=told)
    assert time.monotonic() - began < 20
    assert statuses(outcomes) == {"pi2": "skipped", "pi1": "done", "pi3": "skipped"}
    assert outcomes[0].reason == "interrupted by Ctrl-C"
    assert sorted(outcome.robot for outcome in told.ended_with) == ["pi1", "pi2", "pi3"]
    while len(closed) < 2:
        assert time.monotonic() - began < 20
        time.sleep(0.01)


def test_when_nobody_reads_any_more_everything_ends() -> None:
    """`fab logs --follow | head`: the one that notices ends the others, who would follow for ever."""

    def work(link: Link) -> Outcome:
        if link.robot.name == "writer":
            raise BrokenPipeError
        assert link.closed.wait(10)
        return done(link)

    began = time.monotonic()
    with pytest.raises(BrokenPipeError):
        each(robots("a", "writer", "b"), work, progress=Told())
    assert time.monotonic() - began < 8
