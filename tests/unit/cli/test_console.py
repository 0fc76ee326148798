from __future__ import annotations

import io
import json
import os
import pty
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet import terminal
from fleet.cli import growing_table
from fleet.cli.console import Bars, Lines, Screen, Terminal
from fleet.plan.outcome import Outcome
from fleet.plan.step import Bytes, Plan, Step
from tests.support.samples import PI, TALKER

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[3]

DONE = Outcome(robot="pi1", status="done", summary="release abc", seconds=8.2, sent=242_000_000)
SAME = Outcome(robot="rover-2", status="unchanged", summary="runs release abc", seconds=0.3)
BROKEN = Outcome(
    robot="pi3",
    status="failed",
    step="start release abc",
    reason="container talker is unhealthy\nTraceback (most recent call last):\n  boom",
    cure="`fab logs` shows what it says",
)
GONE = Outcome(
    robot="pi4", status="unreachable", reason="pi4 did not answer within 10 s", cure="has it power?"
)


@pytest.fixture
def screen() -> Screen:
    """A screen that writes into memory, as into a file."""
    made = Screen()
    for console in (made.out, made.err):
        console.file = io.StringIO()
    return made


def out(screen: Screen) -> str:
    assert isinstance(screen.out.file, io.StringIO)
    return screen.out.file.getvalue()


def err(screen: Screen) -> str:
    assert isinstance(screen.err.file, io.StringIO)
    return screen.err.file.getvalue()


def test_outcomes_in_words(screen: Screen) -> None:
    """A line per robot, what was learned of its failure and the cure below it, and the sum beside."""
    screen.outcomes([DONE, SAME, BROKEN, GONE])
    assert out(screen) == (
        "pi1      done         release abc, sent 242 MB, 8 s\n"
        "rover-2  unchanged    runs release abc\n"
        "pi3      failed       start release abc: container talker is unhealthy\n"
        "           | Traceback (most recent call last):\n"
        "           |   boom\n"
        "           cure: `fab logs` shows what it says\n"
        "pi4      unreachable  pi4 did not answer within 10 s\n"
        "           cure: has it power?\n"
    )
    assert err(screen) == "1 done, 1 unchanged, 1 failed, 1 unreachable\n"


@pytest.mark.parametrize(("outcomes", "code"), [((DONE, SAME), 0), ((DONE, GONE), 1), ((), 0)])
def test_the_result_is_shown_and_becomes_the_exit_code(
    screen: Screen, capsys: pytest.CaptureFixture[str], outcomes: tuple[Outcome, ...], code: int
) -> None:
    """For people on their terminal, for programs as JSON alone; the code is the same."""
    assert screen.result(outcomes, json=False) == code
    assert screen.result(outcomes, json=True) == code
    assert [said["robot"] for said in json.loads(capsys.readouterr().out)] == [o.robot for o in outcomes]


def test_problems_go_to_standard_error(screen: Screen) -> None:
    """Where standard output is the robots' own words; who pressed Ctrl-C knows it, and it is no failure."""
    skipped = Outcome(robot="pi5", status="skipped", reason="interrupted by Ctrl-C")
    assert screen.problems([DONE, GONE, skipped]) == 1
    assert screen.problems([DONE, skipped]) == 0
    assert out(screen) == ""
    assert err(screen) == "pi4: pi4 did not answer within 10 s\n  cure: has it power?\n"


def test_a_plan_on_the_screen(screen: Screen) -> None:
    """The very lines of the plan, long ones in one piece."""
    argv = ("sh", "-c", "x" * 500)
    screen.plans([Plan(robot="pi1", summary="new", steps=(Step(title="do", argv=argv),))])
    assert out(screen) == f"pi1: new\n  1. do\n     $ sh -c {'x' * 500}\n"


def test_what_looks_like_markup_is_shown_as_it_is(screen: Screen) -> None:
    """A log line may hold brackets; nothing of a robot's words is style, emoji or markup."""
    text = "[bold]not bold[/] [link=http://x]:smile: [/] \\[x]"
    screen.lines([text])
    screen.say(text)
    screen.table(("a",), [[(text, "")]])
    screen.prefixed(["pi1"])("pi1", text)
    assert out(screen) == f"{text}\na\n{text}\npi1 | {text}\n".replace("a\n", f"{'a':{len(text)}}\n", 1)
    assert err(screen) == f"{text}\n"


def test_lines_of_many_robots_stay_whole(screen: Screen) -> None:
    """Each with its robot's name, in one column, from whichever thread."""
    printer = screen.prefixed(["pi1", "rover-2"])
    threads = [
        threading.Thread(target=lambda name=name: [printer(name, f"line {number}") for number in range(200)])
        for name in ("pi1", "rover-2")
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    lines = out(screen).splitlines()
    for name in ("pi1    ", "rover-2"):
        assert [line for line in lines if line.startswith(name)] == [f"{name} | line {n}" for n in range(200)]
    assert len(lines) == 400


def test_a_long_line_is_not_folded(screen: Screen) -> None:
    """Whoever greps a log finds what is in it."""
    screen.prefixed(["pi1"])("pi1", "x" * 1000)
    assert out(screen) == f"pi1 | {'x' * 1000}\n"


def test_a_table_in_a_file_is_not_folded(screen: Screen) -> None:
    """A reason that is longer than any terminal is wide still is one line for grep."""
    reason = "why " * 100
    screen.table(("robot", "what"), [[("pi1", "bold"), (reason.strip(), "red")], [("rover-2", ""), ("", "")]])
    assert [line.rstrip() for line in out(screen).splitlines()] == [
        "robot    what",
        f"pi1      {reason.strip()}",
        "rover-2",
    ]


def test_a_cell_without_end_is_cut(screen: Screen) -> None:
    """A robot that names a megabyte as its release must not hide the others."""
    screen.table(("robot", "what"), [[("pi1", ""), ("x" * 1_000_000, "")], [("rover-2", ""), ("well", "")]])
    lines = [line.rstrip() for line in out(screen).splitlines()]
    assert lines[1:] == [f"pi1      {'x' * 2000}…", "rover-2  well"]


def test_a_table_that_grows_in_a_file(screen: Screen, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its headings come once, and later rows stand below the first ones."""
    monkeypatch.setattr(growing_table, "FIRST", 0.05)
    monkeypatch.setattr(growing_table, "NEXT", 0.02)
    rows = [[("pi1", "bold"), ("as wide as this", "")]]
    with screen.growing(("robot", "what", "more"), lambda: [[*row, ("m", "")] for row in rows]):
        end = time.monotonic() + 10
        while not out(screen):
            assert time.monotonic() < end
            time.sleep(0.01)
        rows.append([("rover-2\x1b[2J", ""), ("y", "")])
    assert [line.rstrip() for line in out(screen).splitlines()] == [
        "robot  what             more",
        "pi1    as wide as this  m",
        "rover-2  y                m",
    ]


def test_a_table_that_grows_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is drawn again, and the whole of it stays."""
    screen = Screen()
    screen.out = Terminal(file=io.StringIO(), force_terminal=True, width=80)
    rows = [[("pi1", "")]]
    monkeypatch.setenv("TERM", "xterm")
    with screen.growing(("robot",), lambda: list(rows)):
        rows.append([("rover-2", "")])
    last = terminal.plain(out(screen)).splitlines()[-3:]
    assert [line.strip() for line in last if line.strip()][-2:] == ["pi1", "rover-2"]


HOSTILE = "\x1b]0;title\x07\x1b[2J\x1b[10;1H\x9b2Jpi2 | all is well\r\x08\x1b[5n\u202e"


def shown_everywhere(screen: Screen, said: str) -> None:
    """Put a robot's words through everything that shows a robot's words."""
    told = Outcome(robot="pi1", status="failed", step="s", reason=f"{said}\n{said}", cure=said)
    screen.outcomes([told, Outcome(robot="pi2", status="done", summary=said)])
    screen.problems([told])
    screen.table(("a",), [[(said, "red")]])
    screen.records({"pi1": {"key": said, "nested": {"key": said}}})
    screen.lines([said])
    screen.say(said)
    screen.plans([Plan(robot="pi1", summary=said)])
    screen.prefixed(["pi1"])("pi1", said)


def test_a_robots_words_control_nothing(screen: Screen) -> None:
    """No title, no clearing, no cursor over the lines of another robot, no question that the terminal answers."""
    shown_everywhere(screen, HOSTILE)
    for text in (out(screen), err(screen)):
        assert "all is well" in text
        assert not set(text) & {
            *map(chr, range(9)),
            *map(chr, range(11, 32)),
            *map(chr, range(127, 160)),
            "\u202e",
        }


def test_colours_of_a_log_show_on_a_terminal_and_vanish_in_a_file(screen: Screen) -> None:
    """A program's warnings are yellow for a reason; the colour ends with the line."""
    printer = screen.prefixed(["pi1"])
    printer("pi1", "\x1b[33mcareful")
    assert out(screen) == "pi1 | careful\n"
    screen.out = Terminal(file=io.StringIO(), force_terminal=True, width=80, color_system="standard")
    screen.prefixed(["pi1"])("pi1", "\x1b[33mcareful")
    assert out(screen) == "\x1b[36mpi1 | \x1b[0m\x1b[33mcareful\x1b[0m\n"


def test_values_of_a_robot_by_dotted_keys(screen: Screen) -> None:
    """As `fab inventory` shows them."""
    screen.records({"pi1": {"address": "pi1.local", "ros": {"master": "own"}, "files": {}, "port": 22}})
    assert out(screen) == (
        "pi1\n"
        "  address                  pi1.local\n"
        "  ros.master               own\n"
        "  port                     22\n"
    )


def test_images_as_a_table_and_as_json(screen: Screen, capsys: pytest.CaptureFixture[str]) -> None:
    """What `fab build` made."""
    screen.images([TALKER], json=False)
    assert (
        out(screen) == "image                platform     size  \ntalker:latest-arm64  linux/arm64  241 MB\n"
    )
    screen.images([TALKER], json=True)
    assert json.loads(capsys.readouterr().out)[0]["reference"] == "talker:latest-arm64"


def test_json_holds_no_bytes(screen: Screen, capsys: pytest.CaptureFixture[str]) -> None:
    """They may be a robot's secrets; their number says enough."""
    step = Step(title="t", argv=("a", "b"), feed=Bytes(label="l", data=b"secret"))
    screen.json(
        {"plans": [Plan(robot="pi1", summary="ü", steps=(step,))], "path": Path("/x"), "robot": PI.name}
    )
    said = json.loads(capsys.readouterr().out)
    assert said["plans"][0]["steps"][0]["feed"] == {"label": "l", "data": "6 bytes"}
    assert said["plans"][0]["steps"][0]["argv"] == ["a", "b"]
    assert (said["plans"][0]["summary"], said["path"]) == ("ü", "/x")


def test_nobody_there_is_a_no(screen: Screen, monkeypatch: pytest.MonkeyPatch) -> None:
    """A question without a terminal is answered by nobody."""
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert screen.confirm("Record 2 host keys?") is False


def test_nobody_there_gives_the_default(screen: Screen, monkeypatch: pytest.MonkeyPatch) -> None:
    """A script that runs `fab init` is not asked."""
    monkeypatch.setattr("sys.stdin", io.StringIO("pi1=10.0.0.1\n"))
    assert screen.ask("Your robots?", default="none") == "none"
    assert err(screen) == ""


def test_progress_where_nobody_watches_is_lines(screen: Screen) -> None:
    """One when a robot begins something, one when it is through."""
    progress = screen.progress()
    assert isinstance(progress, Lines)
    with progress:
        progress.step_started("pi1", "load talker", 242_000_000)
        progress.bytes_sent("pi1", 1000)
        progress.step_started("pi1", "start it", None)
        progress.finished(DONE)
    assert err(screen) == "pi1: load talker (242 MB)\npi1: start it\npi1: done after 8 s\n"
    assert out(screen) == ""


def test_a_step_of_all_robots_is_one_line(screen: Screen) -> None:
    """With 20 robots, 20 equal lines would hide the result; a later repetition by one robot is shown again."""
    with screen.progress() as progress:
        progress.announce(["pi1", "pi2"], "look at the robot")
        for robot in ("pi1", "pi2", "pi2"):
            progress.step_started(robot, "look at the robot", None)
        progress.announce(["pi3"], "look at the robot")
        progress.step_started("pi3", "look at the robot", None)
    assert err(screen) == "2 robots: look at the robot\npi2: look at the robot\npi3: look at the robot\n"


def until(seen: Callable[[], bool]) -> None:
    """Wait for what another thread draws ten times a second."""
    end = time.monotonic() + 10
    while not seen():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_progress_on_a_terminal_moves_and_leaves_nothing_behind() -> None:
    """Bytes, rate and time left where bytes flow; when it ends, the lines are gone."""
    console = Terminal(file=io.StringIO(), force_terminal=True, width=120, legacy_windows=False)
    with Bars(console) as progress:
        progress.step_started("pi1", "load [talker]", 242_000_000)
        progress.bytes_sent("pi1", 121_000_000)
        until(lambda: "121.0/242.0 MB" in console.file.getvalue())  # type: ignore[attr-defined]
        console.print("meanwhile")
        progress.finished(DONE)
        progress.bytes_sent("pi1", 5)
        progress.finished(GONE)
        progress.step_started("talker:latest-arm64", "build", None)
        progress.ended("talker:latest-arm64")
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert "load [talker]" in text
    assert "meanwhile" in text
    assert terminal.plain(text.rpartition("\x1b[2K")[2]) == ""


def on_a_terminal(script: str) -> str:
    """What a script prints on a terminal of 80 columns."""
    master, slave = pty.openpty()
    environment = {
        "PYTHONPATH": str(ROOT),
        "TERM": "xterm-256color",
        "COLUMNS": "80",
        "PATH": os.environ["PATH"],
    }
    process = subprocess.Popen((sys.executable, "-c", script), stdout=slave, stdin=slave, env=environment)
    os.close(slave)
    text = b""
    try:
        while piece := os.read(master, 4096):
            text += piece
    except OSError:  # the last holder of the other end has closed it
        pass
    os.close(master)
    assert process.wait() == 0
    return text.decode().replace("\r\n", "\n")


def test_a_terminal_gets_colours_and_its_own_width() -> None:
    """A table fits the window there."""
    text = on_a_terminal(
        "from fleet.cli.console import Screen\n"
        "Screen().table(('robot', 'what'), [[('pi1', 'bold red'), ('why ' * 100, '')]])"
    )
    assert "\x1b[1;31mpi1" in text
    assert max(len(line) for line in terminal.plain(text).splitlines()) == 80


def test_a_line_of_text_is_asked_for_on_a_terminal() -> None:
    """`fab init` asks for robots; Enter, and the end of the input, mean the default."""
    script = (
        "import io, sys\n"
        "from fleet.cli.console import Screen\n"
        "sys.stderr = sys.stdout\n"
        "class Answer(io.StringIO):\n"
        "    isatty = lambda self: True\n"
        "for answer in (' pi1=a \\n', '\\n', ''):\n"
        "    sys.stdin = Answer(answer)\n"
        "    print('<' + Screen().ask('Your robots?', default='later') + '>')\n"
    )
    text = on_a_terminal(script)
    assert text.count("Your robots?") == 3
    assert [word for word in text.split() if word.startswith("<")] == ["<pi1=a>", "<later>", "<later>"]


def test_a_question_on_a_terminal_is_asked() -> None:
    """`fab trust` records keys only after a yes."""
    script = (
        "import io, sys\n"
        "from fleet.cli.console import Screen\n"
        "sys.stderr = sys.stdout\n"
        "class Answer(io.StringIO):\n"
        "    isatty = lambda self: True\n"
        "for answer in ('y', 'YES', '', 'no'):\n"
        "    sys.stdin = Answer(answer + chr(10))\n"
        "    print(Screen().confirm('Record 2 host keys?'))\n"
    )
    text = on_a_terminal(script)
    assert "Record 2 host keys? [y/N]" in text
    assert [word for word in text.split() if word in ("True", "False")] == ["True", "True", "False", "False"]


def test_a_reader_that_is_gone_is_an_exception_and_not_an_end() -> None:
    """Whoever prints decides what to do: a thread must not end the program, nor go on printing for ever."""
    read, write = os.pipe()
    os.close(read)
    console = Terminal(file=os.fdopen(write, "w"))
    with pytest.raises(BrokenPipeError):
        console.print("nobody reads this")
    with pytest.raises(BrokenPipeError):
        console.file.close()
