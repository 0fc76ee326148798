from __future__ import annotations

import hashlib
import os
import resource
import signal
import threading
import time
from typing import TYPE_CHECKING

import pytest

from fleet.errors import LinkLost, NotAsPlanned, TimedOut
from fleet.ssh import channel, connect

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from fleet.ssh.session import Session
    from tests.support.sshd import Sshd, Sshds

MEGABYTE = 1 << 20


@pytest.fixture
def session(sshds: Sshds, sshd: Sshd) -> Iterator[Session]:
    with connect.connect(sshd.robot(), link_timeout=5, config=sshds.config) as connected:
        yield connected


def peak() -> int:
    """The most memory this process ever had, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def test_a_stream_arrives_whole_and_in_flat_memory(session: Session) -> None:
    """600 MB: more than one set of SSH keys is used for, so a key exchange happens in the middle."""
    piece, count = os.urandom(3 * MEGABYTE + 17), 200
    digest, told = hashlib.sha256(), 0
    for _ in range(count):
        digest.update(piece)

    def tell(size: int) -> None:
        nonlocal told
        told += size

    before = peak()
    said = session.run(("sha256sum",), feed=(piece for _ in range(count)), limit=None, on_sent=tell)
    assert said.output.split()[0] == digest.hexdigest()
    assert told == count * len(piece)
    assert peak() - before < 60


def test_much_output_is_taken_in_linear_time(session: Session) -> None:
    """64 MB, kept whole. The quadratic way takes minutes."""
    started = time.monotonic()
    said = session.run(("head", "-c", "64M", "/dev/zero"), keep=64 * MEGABYTE)
    assert len(said.output) == 64 * MEGABYTE
    assert time.monotonic() - started < 30


def test_much_output_for_a_hearer_is_not_kept(session: Session) -> None:
    """Following logs for a week must not fill memory. Over 512 MB, so keys are exchanged anew meanwhile."""
    count = 0

    def hear(data: bytes) -> None:
        nonlocal count
        count += len(data)

    before = peak()
    said = session.run(("head", "-c", "600M", "/dev/zero"), on_output=hear)
    assert count == 600 * MEGABYTE
    assert said.output == ""
    assert peak() - before < 60


@pytest.mark.parametrize("where", ["", " >&2"], ids=["output", "errors"])
def test_a_robot_that_prints_without_end_is_not_read_on(session: Session, where: str) -> None:
    """Some megabytes are read, not ten gigabytes; that is told, and the connection is over."""
    before, started = peak(), time.monotonic()
    with pytest.raises(NotAsPlanned, match=r"printed more than 4.0 MB, so it was not read any further"):
        session.run(("sh", "-c", f"head -c 10G /dev/zero{where}"))
    assert peak() - before < 40
    assert time.monotonic() - started < 10
    with pytest.raises(LinkLost):
        session.run(("true",))


def test_errors_are_heard_as_they_come(session: Session) -> None:
    """Also when they never end: the output beside them is not forgotten, and the limit holds."""
    count, heard = [0], list[bytes]()

    def hear(data: bytes) -> None:
        count[0] += len(data)

    with pytest.raises(TimedOut):
        session.run(
            ("sh", "-c", "echo one; exec cat /dev/zero >&2"),
            limit=1,
            on_output=heard.append,
            on_errors=hear,
        )
    assert heard == [b"one\n"]
    assert count[0] > MEGABYTE


def test_a_command_that_talks_while_it_is_fed_does_not_deadlock(session: Session) -> None:
    """Both directions are full at once: 32 MB in, 32 MB out on each of two ways out."""
    piece = os.urandom(MEGABYTE)
    heard: list[bytes] = []
    said = session.run(
        ("tee", "/dev/stderr"),
        feed=(piece for _ in range(32)),
        on_output=heard.append,
        keep=64 * MEGABYTE,
    )
    assert b"".join(heard) == piece * 32
    assert len(said.errors) > 32 * MEGABYTE / 4


def test_a_command_that_ends_while_it_is_fed_tells_its_own_reason(session: Session) -> None:
    """Not "Socket is closed": its code and its words."""
    fed = 0

    def feed() -> Iterator[bytes]:
        nonlocal fed
        for _ in range(500):
            fed += 1
            yield bytes(MEGABYTE)

    said = session.run(("sh", "-c", "head -c 3000000 >/dev/null; echo no space >&2; exit 7"), feed=feed())
    assert (said.code, said.errors) == (7, "no space\n")
    assert fed < 100


def test_a_command_that_takes_no_input_is_not_disturbed_by_it(session: Session) -> None:
    """It closes its input and works on."""
    script = "exec <&-; sleep 1; echo done"
    said = session.run(("sh", "-c", script), feed=(bytes(MEGABYTE) for _ in range(20)))
    assert (said.code, said.output) == (0, "done\n")


@pytest.mark.parametrize(
    ("name", "command"), [("TAKES_WITHIN", "sleep 30"), ("ENDS_WITHIN", "cat; sleep 30")]
)
def test_a_robot_that_does_not_go_on_is_left(
    session: Session, monkeypatch: pytest.MonkeyPatch, name: str, command: str
) -> None:
    """Its sshd answers, and its `docker load` never takes the next byte, or never ends."""
    monkeypatch.setattr(channel, name, 0.5)
    feed = (bytes(MEGABYTE) for _ in range(20))
    started = time.monotonic()
    with pytest.raises(TimedOut, match="does not go on with what it was sent"):
        session.run(("sh", "-c", command), feed=feed, limit=None, on_output=lambda _: None)
    assert time.monotonic() - started < 8


def test_a_feed_that_waits_is_no_robot_that_does_not_go_on(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This computer packs a layer meanwhile: the robot has nothing to take."""
    monkeypatch.setattr(channel, "TAKES_WITHIN", 0.5)

    def feed() -> Iterator[bytes]:
        yield b"one"
        time.sleep(1.5)
        yield b" two"

    assert session.run(("cat",), feed=feed(), limit=None).output == "one two"


def test_a_feed_that_fails_ends_the_connection(session: Session) -> None:
    """What is wrong with the feed is what is raised, and nothing else is run on that connection."""

    def feed() -> Iterator[bytes]:
        yield bytes(MEGABYTE)
        raise ValueError("the image is gone")

    with pytest.raises(ValueError, match="the image is gone"):
        session.run(("cat",), feed=feed())
    with pytest.raises(LinkLost):
        session.run(("true",))


def test_a_feed_is_closed_in_the_end(session: Session) -> None:
    """Whatever holds a file or a process behind it, also when nobody wants the rest."""
    closed = threading.Event()

    def feed() -> Iterator[bytes]:
        try:
            while True:
                yield bytes(MEGABYTE)
        finally:
            closed.set()

    assert session.run(("true",), feed=feed()).code == 0
    assert closed.wait(5)


def test_no_feed_is_an_end_of_input(session: Session) -> None:
    """The usual command does not wait for a person to type."""
    assert session.run(("cat",)).output == ""


def test_an_open_input_ends_with_the_connection(session: Session, tmp_path: Path) -> None:
    """`logs --follow` leaves nothing running on the robot: its input ends when we are gone."""
    heard = threading.Event()

    def hear(_: bytes) -> None:
        heard.set()

    script = f"echo ready; cat >/dev/null; touch {tmp_path}/ended"

    def leave() -> None:
        heard.wait(10)
        session.close()

    threading.Thread(target=leave).start()
    with pytest.raises(LinkLost):
        session.run(("sh", "-c", script), feed=None, limit=None, on_output=hear)
    deadline = time.monotonic() + 10
    while not (tmp_path / "ended").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert heard.is_set()
    assert (tmp_path / "ended").exists()


def test_output_is_heard_as_it_comes(session: Session, tmp_path: Path) -> None:
    """The command goes on only after its line was heard."""

    def hear(data: bytes) -> None:
        (tmp_path / data.decode().strip()).touch()

    wait = f"while [ ! -e {tmp_path}/one ]; do sleep 0.02; done"
    assert session.run(("sh", "-c", f"echo one; {wait}; echo two"), limit=10, on_output=hear).code == 0
    assert (tmp_path / "two").exists()


def test_a_hearer_that_fails_ends_the_connection(session: Session) -> None:
    """Its error is the one that is raised."""

    def hear(_: bytes) -> None:
        raise BrokenPipeError("head has ended")

    with pytest.raises(BrokenPipeError, match="head has ended"):
        session.run(("echo", "hello"), on_output=hear)


def test_a_command_without_output_left_runs_to_its_end(session: Session) -> None:
    """It closed its output, like a daemon does, and we wait without spinning."""
    started = time.process_time()
    assert session.run(("sh", "-c", "exec >&- 2>&-; sleep 2; exit 4"), limit=None).code == 4
    assert time.process_time() - started < 0.5


def test_output_held_open_by_what_a_command_started_is_not_waited_for(session: Session) -> None:
    """`docker compose up` may leave something behind that keeps its output."""
    started = time.monotonic()
    said = session.run(("sh", "-c", "sleep 20 & echo started"), limit=None)
    assert (said.code, said.output) == (0, "started\n")
    assert time.monotonic() - started < 10


def test_a_quiet_command_outlasts_the_silence(sshds: Sshds, sshd: Sshd) -> None:
    """The robot is asked whether it is there, and its sshd answers."""
    with connect.connect(sshd.robot(), link_timeout=1, config=sshds.config) as session:
        assert session.run(("sh", "-c", "sleep 3; echo slept")).output == "slept\n"


@pytest.mark.parametrize("feeding", [False, True])
def test_a_robot_that_freezes_is_noticed(sshds: Sshds, sshd: Sshd, *, feeding: bool) -> None:
    """In mid-command and in mid-stream: its kernel still answers, nothing else does."""
    with connect.connect(sshd.robot(), link_timeout=1.5, config=sshds.config) as session:
        feed = (bytes(MEGABYTE) for _ in range(1 << 20))
        threading.Timer(0.5, sshd.signal, args=(signal.SIGSTOP,)).start()
        started = time.monotonic()
        with pytest.raises(LinkLost, match="nothing was heard from the robot for"):
            session.run(
                ("cat", "/dev/stdin"), feed=feed if feeding else None, limit=None, on_output=lambda _: None
            )
        assert time.monotonic() - started < 5
        sshd.signal(signal.SIGCONT)


def test_a_robot_that_freezes_for_a_moment_is_waited_for(sshds: Sshds, sshd: Sshd) -> None:
    """A Wi-Fi roam takes seconds."""
    with connect.connect(sshd.robot(), link_timeout=4, config=sshds.config) as session:
        threading.Timer(0.3, sshd.signal, args=(signal.SIGSTOP,)).start()
        threading.Timer(2.3, sshd.signal, args=(signal.SIGCONT,)).start()
        assert session.run(("sh", "-c", "sleep 1; echo back")).output == "back\n"
