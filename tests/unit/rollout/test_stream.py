from __future__ import annotations

import itertools
import os
import signal
import threading
import time
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.errors import NotReady
from fleet.rollout import stream
from fleet.rollout.stream import LONGEST_LINE, Lines
from tests.support.homes import Home, Told, start, statuses
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from tests.support.sshd import Sshds


class Printed:
    """A printer that remembers."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __call__(self, name: str, text: str) -> None:
        self.lines.append((name, text))

    def of(self, name: str) -> list[str]:
        return [text for who, text in self.lines if who == name]


@pytest.fixture
def home(sshds: Sshds) -> Home:
    return start(sshds, "pi1")


@pytest.mark.parametrize(
    ("said", "lines"),
    [
        (b"", []),
        (b"one\ntwo\n", ["one", "two"]),
        (b"one\r\ntwo", ["one", "two"]),
        (b"\n\n", ["", ""]),
        (b"\xff\xfe\n", ["��"]),
        ("Grüße ☃\n".encode(), ["Grüße ☃"]),
    ],
)
def test_bytes_become_lines(said: bytes, lines: list[str]) -> None:
    """The last one need not have an end; what is no text does not stop the rest."""
    got: list[str] = []
    taker = Lines(got.append)
    taker.on_output(said)
    taker.end()
    assert got == lines


@given(st.binary(), st.lists(st.integers(min_value=0, max_value=200)))
def test_where_the_pieces_are_cut_does_not_matter(said: bytes, cuts: list[int]) -> None:
    """Networks cut in the middle of letters."""
    whole: list[str] = []
    taker = Lines(whole.append)
    taker.on_output(said)
    taker.end()
    pieces: list[str] = []
    taker = Lines(pieces.append)
    at = [0, *sorted(min(cut, len(said)) for cut in cuts), len(said)]
    for begin, end in itertools.pairwise(at):
        taker.on_output(said[begin:end])
    taker.end()
    assert pieces == whole


@given(st.integers(0, 2 * LONGEST_LINE), st.lists(st.integers(0, 3 * LONGEST_LINE), max_size=5))
def test_a_line_without_end_is_shown_in_parts(more: int, cuts: list[int]) -> None:
    """Nothing is lost, wherever the network cuts, and no more than one part is kept."""
    said, got = b"x" * (LONGEST_LINE + more), list[str]()
    taker = Lines(got.append)
    at = [0, *sorted(min(cut, len(said)) for cut in cuts), len(said)]
    for begin, end in itertools.pairwise(at):
        taker.on_output(said[begin:end])
    taker.end()
    assert "".join(got) == said.decode()
    assert [len(part) for part in got[:-1]] == [LONGEST_LINE] * (len(got) - 1)
    assert 0 < len(got[-1]) <= LONGEST_LINE


def test_a_command_on_many_robots(sshds: Sshds, home: Home) -> None:
    """Each line under its robot's name, standard error too; one that fails or is away does not silence the rest."""
    other = start(sshds, "pi2")
    (home.path / "fine").touch()
    away = home.robot.model_copy(update={"name": "pi3", "port": free_port()})
    printed = Printed()
    outcomes = stream.run(
        [home.robot, other.robot, away],
        'echo "it\'s $((1+1))"; echo oh >&2; test -e fine || exit 3',
        limit=20,
        printer=printed,
        progress=Told(),
    )
    assert statuses(outcomes) == {"pi1": "done", "pi2": "failed", "pi3": "unreachable"}
    assert outcomes[1].reason == "ended with code 3"
    assert printed.of("pi1") == printed.of("pi2") == ["it's 2", "oh"]
    assert printed.of("pi3") == []


def test_a_command_gets_no_input_and_a_limit(home: Home) -> None:
    """`cat` ends at once, and what does not end is ended."""
    printed = Printed()
    assert statuses(stream.run([home.robot], "cat", limit=20, printer=printed, progress=Told())) == {
        "pi1": "done"
    }
    (late,) = stream.run([home.robot], "echo one; sleep 20", limit=1, printer=printed, progress=Told())
    assert (late.status, printed.of("pi1")) == ("failed", ["one"])
    assert "took longer than 1 s" in late.reason


def test_without_a_limit(home: Home) -> None:
    """0 is any time."""
    (outcome,) = stream.run([home.robot], "echo 1", limit=0, printer=Printed(), progress=Told())
    assert outcome.status == "done"


def test_logs_are_read_to_their_end(home: Home) -> None:
    """What to run comes from the robot's facts; a robot that has none is refused alone."""

    def argv(robot: Robot, facts: Facts) -> tuple[str, ...]:
        if not facts.fleet.stacks:
            raise NotReady("nothing has been shipped to it")
        return ("printf", "%s\n", robot.name, *facts.fleet.stacks)

    printed = Printed()
    (refused,) = stream.logs([home.robot], argv, follow=False, printer=printed, progress=Told())
    assert refused.reason == "nothing has been shipped to it"
    (home.path / ".fleet/stacks/abc").mkdir(parents=True)
    (done,) = stream.logs([home.robot], argv, follow=False, printer=printed, progress=Told())
    assert (done.status, printed.of("pi1")) == ("done", ["pi1", "abc"])


def test_logs_are_followed_until_ctrl_c(home: Home) -> None:
    """Lines come as they are written; the input stays open, so that the end of the connection can be noticed."""
    script = "echo one; until [ -e go ]; do sleep 0.05; done; echo two; cat; touch ended"
    printed, early = Printed(), list[bool]()

    def person() -> None:
        while not printed.lines:
            time.sleep(0.01)
        (home.path / "go").touch()
        while len(printed.lines) < 2:
            time.sleep(0.01)
        time.sleep(0.3)
        early.append((home.path / "ended").exists())
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=person)
    thread.start()
    (outcome,) = stream.logs(
        [home.robot],
        lambda _robot, _facts: ("sh", "-c", script),
        follow=True,
        printer=printed,
        progress=Told(),
    )
    thread.join()
    assert (outcome.status, printed.of("pi1")) == ("skipped", ["one", "two"])
    assert early == [False]
    end = time.monotonic() + 10
    while not (home.path / "ended").exists():  # `cat` read the end of its input
        assert time.monotonic() < end
        time.sleep(0.01)
