from __future__ import annotations

import signal
import threading
import time
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet.errors import LinkLost, NotReady, TimedOut
from fleet.ssh import channel, connect
from fleet.ssh.session import Result

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from fleet.ssh.session import Session, Stream
    from tests.support.sshd import Sshd, Sshds

WORDS = st.one_of(
    st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"), max_size=20),
    st.sampled_from(
        [
            "",
            " ",
            "a b",
            "'",
            '"',
            "\\",
            "\n",
            "$(reboot)",
            "`reboot`",
            "-n",
            "--help",
            "*",
            "~",
            "\t",
            "é😀",
            ";",
            "&",
            "#",
        ]
    ),
)


@pytest.fixture
def session(sshds: Sshds, sshd: Sshd) -> Iterator[Session]:
    with connect.connect(sshd.robot(), link_timeout=5, config=sshds.config) as connected:
        yield connected


def test_arguments_arrive_as_they_are(session: Session) -> None:
    """No word is ever seen by a shell, whatever is in it."""

    @given(words=st.lists(WORDS, max_size=5))
    @settings(max_examples=60, deadline=None)
    def check(words: list[str]) -> None:
        said = session.run(("printf", r"%s\0", "begin", *words)).output
        assert said == "".join(word + "\0" for word in ("begin", *words))

    check()


def test_a_result_has_code_output_and_errors(session: Session) -> None:
    """The three things a command has to say; bytes that are not UTF-8 do not hurt."""
    said = session.run(("sh", "-c", r"printf 'out\377\n'; echo err >&2; exit 3"))
    assert said == Result(code=3, output="out\ufffd\n", errors="err\n")


def test_commands_follow_each_other_on_one_connection(session: Session) -> None:
    """A session is not used up by a command, a failed one neither."""
    assert [session.run(("sh", "-c", f"exit {code}")).code for code in (0, 1, 126, 255, 0)] == [
        0,
        1,
        126,
        255,
        0,
    ]


def test_a_missing_command_is_a_result(session: Session) -> None:
    """The shell's 127 is told, with its words."""
    said = session.run(("no-such-command",))
    assert said.code == 127
    assert "no-such-command" in said.errors


def test_a_command_over_its_limit_is_ended_on_the_robot(session: Session, tmp_path: Path) -> None:
    """Nothing runs on there, and the connection is good for more."""
    with pytest.raises(TimedOut, match="`sh` took longer than"):
        session.run(("sh", "-c", f"echo $$ > {tmp_path}/pid; sleep 6543; echo no"), limit=0.5)
    gone = session.run(("sh", "-c", f"! kill -0 $(cat {tmp_path}/pid)"))
    assert gone.code == 0
    assert session.run(("pgrep", "-f", "^sleep 6543$")).output == ""


def test_a_command_that_ignores_its_end_is_killed(session: Session) -> None:
    """SIGTERM first, five seconds later SIGKILL."""
    started = time.monotonic()
    with pytest.raises(TimedOut):
        session.run(("sh", "-c", "trap '' TERM; while :; do sleep 0.1; done"), limit=0.2)
    assert time.monotonic() - started < 10


@pytest.mark.parametrize("code", [124, 137, 143])
def test_the_codes_of_timeout_are_a_commands_own_before_its_limit(session: Session, code: int) -> None:
    """A container killed for want of memory says 137 too: that is no time limit."""
    assert session.run(("sh", "-c", f"exit {code}")).code == code


def test_a_command_without_limit_may_be_ended_by_a_signal(session: Session) -> None:
    """SSH has no exit code for that; it must not look like a lost link."""
    assert session.run(("sh", "-c", "kill -KILL $$"), limit=None).code == -1
    assert session.run(("echo", "still there")).output == "still there\n"


def test_close_from_another_thread_ends_a_command_at_once(session: Session) -> None:
    """This is Ctrl-C."""
    started = time.monotonic()
    threading.Timer(0.3, session.close).start()
    with pytest.raises(LinkLost):
        session.run(("sleep", "30"))
    assert time.monotonic() - started < 2


def test_close_ends_a_stream_at_once(session: Session) -> None:
    """Ctrl-C while bytes flow that the robot does not take."""
    started = time.monotonic()
    threading.Timer(0.5, session.close).start()
    with pytest.raises(LinkLost):
        session.run(("sleep", "30"), feed=(bytes(1 << 20) for _ in range(100)))
    assert time.monotonic() - started < 3


def test_a_closed_session_runs_nothing(session: Session) -> None:
    """Twice closed is closed."""
    session.close()
    session.close()
    with pytest.raises(LinkLost, match="before the command started"):
        session.run(("true",))


def test_a_frozen_robot_starts_no_command_and_is_noticed(sshds: Sshds, sshd: Sshd) -> None:
    """Its kernel answers, its sshd does not: the hardest silence to see."""
    with connect.connect(sshd.robot(), link_timeout=1, config=sshds.config) as session:
        sshd.signal(signal.SIGSTOP)
        started = time.monotonic()
        with pytest.raises(LinkLost, match="before the command started"):
            session.run(("true",))
        assert time.monotonic() - started < 3


def test_a_restarted_sshd_is_a_lost_link(sshds: Sshds, sshd: Sshd) -> None:
    """What a robot does that loses its power in mid-command."""
    with connect.connect(sshd.robot(), config=sshds.config) as session:
        threading.Timer(0.3, sshd.stop).start()
        started = time.monotonic()
        with pytest.raises(LinkLost, match="while the command ran"):
            session.run(("sleep", "30"))
        assert time.monotonic() - started < 3


def test_a_command_hears_that_somebody_listens(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """A byte now and then, from whose end a robot knows that the link is lost; and not a word too much."""
    monkeypatch.setattr(channel, "BEAT", 0.2)
    assert session.run(("timeout", "5", "head", "-c", "3"), feed=None).output == "..."
    assert session.run(("timeout", "5", "head", "-c", "3"), feed=()).output == ""


def test_a_connection_that_is_made_on_the_robot_arrives_here(session: Session) -> None:
    """As many as are made, while a command runs; afterwards the port is closed."""

    def shout(stream: Stream) -> None:
        stream.sendall(stream.recv(100).upper())

    with session.forwarded(shout) as port:
        script = f"exec 3<>/dev/tcp/127.0.0.1/{port} && echo hello >&3 && head -n 1 <&3"
        for _ in range(2):
            assert session.run(("bash", "-c", script)).output == "HELLO\n"
    assert session.run(("bash", "-c", script)).code != 0


def test_an_sshd_that_forwards_no_ports_says_so(sshds: Sshds) -> None:
    """With the line of its configuration that would allow it."""
    strict = sshds.start("strict", options=("AllowTcpForwarding no",))
    with connect.connect(strict.robot(), link_timeout=5, config=sshds.config) as connected:
        with pytest.raises(NotReady, match="forwards no ports") as refused, connected.forwarded(print):
            pass
        assert "AllowTcpForwarding yes" in refused.value.cure
        assert connected.run(("echo", "on")).output == "on\n"


def test_a_frozen_robot_forwards_nothing_and_is_noticed(sshds: Sshds, sshd: Sshd) -> None:
    """As with a command."""
    with connect.connect(sshd.robot(), link_timeout=1, config=sshds.config) as connected:
        sshd.signal(signal.SIGSTOP)
        try:
            with pytest.raises(LinkLost), connected.forwarded(print):
                pass
        finally:
            sshd.signal(signal.SIGCONT)
