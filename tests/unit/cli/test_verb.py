from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from fleet.cli import main, verb
from fleet.errors import DesktopError, UsageError
from tests.support import project
from tests.support.project import FAB, ROOT, Project

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.sshd import Sshds


@pytest.fixture
def mine(sshds: Sshds) -> Project:
    """One robot, and one that is away."""
    return project.make(sshds, "pi1")


GIVEN: list[tuple[str, int, bool]] = []


def do(what: str = "", count: int = 3, dry: bool = False) -> int:
    """Do it.

    At length.
    """
    GIVEN.append((what, count, dry))
    return 0


def program(body: Callable[..., int | None], *words: str) -> int:
    """Type ``fleet`` and these words, where ``body`` is a verb; the exit code."""
    GIVEN.clear()
    argv, sys.argv = sys.argv, ["fleet", *words]
    try:
        verbs = (verb.verb({"what": "w"} if body is do else {})(body),)
        verb.main(verb.collection(verbs, default=look), overview=lambda: "our page\n")
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = argv
    return 0


@verb.verb(looks=True)
def look() -> int:
    """Look."""
    return 0


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ((), ("", 3, False)),
        (("--what", "a b"), ("a b", 3, False)),
        (("--count", "5"), ("", 5, False)),
        (("--count=0", "--dry"), ("", 0, True)),
    ],
)
def test_a_function_becomes_a_verb(words: tuple[str, ...], given: tuple[str, int, bool]) -> None:
    """Its parameters are its flags, with their types and defaults."""
    assert program(do, "do", *words) == 0
    assert [given] == GIVEN


@pytest.mark.parametrize(
    "words", [("--dry", "do"), ("-R", "do"), ("do", "--dry"), ("do", "--what", "x", "--dry")]
)
def test_dry_counts_wherever_it_stands(words: tuple[str, ...]) -> None:
    """Invoke has a flag of that name of its own, which means the same to a person."""
    assert program(do, *words) == 0
    assert [dry for _, _, dry in GIVEN] == [True]


def test_a_verb_without_a_dry_run_is_not_run_dry(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is worse than a dry run that is none."""

    def reboot() -> int:
        """Reboot."""
        raise AssertionError

    assert program(reboot, "--dry", "reboot") == 2
    assert "nothing was done" in capsys.readouterr().err


def test_a_verb_that_looks_only_may_run_dry() -> None:
    """It changes nothing anyway."""
    assert program(do, "--dry", "look") == 0


@pytest.mark.parametrize("count", ["abc", "-1", "1.5", "", "5x"])
def test_a_number_that_is_none_is_refused(count: str, capsys: pytest.CaptureFixture[str]) -> None:
    """In a sentence."""
    assert program(do, "do", f"--count={count}") == 2
    assert capsys.readouterr().err == f"--count takes a whole number, not {count}\n"


@pytest.mark.parametrize(
    ("problem", "code", "err"),
    [
        (
            UsageError("there is no robot x", cure="did you mean 'y'?"),
            2,
            "there is no robot x\n  cure: did you mean 'y'?\n",
        ),
        (DesktopError("Docker does not answer"), 1, "Docker does not answer\n"),
    ],
)
def test_our_errors_are_a_sentence_and_a_code(
    problem: Exception, code: int, err: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """2 for the person's mistakes, 1 for the world's."""

    def fail() -> int:
        """Fail."""
        raise problem

    assert program(fail, "fail") == code
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", err)


@pytest.mark.parametrize(("returned", "code"), [(None, 0), (0, 0), (1, 1)])
def test_what_a_verb_returns_is_the_exit_code(returned: int | None, code: int) -> None:
    """Nothing is 0."""

    def end() -> int | None:
        """End."""
        return returned

    assert program(end, "end") == code


def test_help_tells_what_a_verb_does_and_what_its_flags_mean(capsys: pytest.CaptureFixture[str]) -> None:
    """Those that all verbs share are told once, here."""
    assert program(do, "--help", "do") == 0
    text = capsys.readouterr().out
    assert "Do it.\n\n  At length." in text
    assert verb.HELP["dry"] in text
    assert "-h" not in text.partition("Options:")[2]  # `hosts` must not steal it


def test_a_bug_is_not_hidden() -> None:
    """What is nobody's mistake but ours is shown as it is."""

    def bug() -> int:
        """Bug."""
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        program(bug, "bug")


@pytest.mark.parametrize(
    "words",
    [
        ("-H", "pi1", "ship"),
        ("--hosts", "pi1", "ship"),
        ("--hosts=pi1", "ship"),
        ("ship", "-H", "pi1"),
    ],
)
def test_hosts_before_the_task_is_refused_with_the_right_spelling(
    mine: Project, words: tuple[str, ...]
) -> None:
    """Fabric would run the task on every robot."""
    done = mine.fab(*words)
    assert (done.code, done.out, done.err) == (2, "", "--hosts comes after the task: fab ship --hosts pi1\n")


def test_what_follows_the_dashes_is_a_command_for_the_robots(mine: Project) -> None:
    """Their shell reads it, as it reads ssh's; flags in it are the command's own."""
    done = mine.fab("run", "--hosts", "pi1", "--", "echo", "$((40+2))", "--dry", "-H", "x; pwd")
    assert (done.code, done.out) == (0, f"pi1 | 42 --dry -H x\npi1 | {mine.robots['pi1'].path}\n")


@pytest.mark.parametrize(
    "words", [("build", "--", "x"), ("run", "--", "true", "status"), ("status", "--", "uptime")]
)
def test_only_run_takes_a_command(mine: Project, words: tuple[str, ...]) -> None:
    """Fabric would run it on hosts that nobody named."""
    done = mine.fab(*words)
    if words[0] == "run":  # `status` is part of the command
        assert done.code == 1
    else:
        assert (done.code, done.out) == (2, "")
        assert done.err.startswith("only `run` takes a command after `--`")


def test_ctrl_c_ends_a_verb_with_what_became_of_each_robot(mine: Project) -> None:
    """In the middle of a command, within seconds, without a traceback."""
    process = subprocess.Popen(
        (str(FAB), "run", "--hosts", "pi1", "--", "echo one; sleep 20"),
        cwd=mine.folder,
        env=mine.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    # Not before the line is here: what the robot has written may still be on its way.
    assert process.stdout.readline() == "pi1 | one\n"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=15)
    assert (out, err) == ("", "")


@pytest.mark.parametrize(
    "words", [("inventory",), ("inventory", "--json"), ("run", "--hosts", "pi1", "--", "echo 1")]
)
def test_nobody_reads_at_all(mine: Project, words: tuple[str, ...]) -> None:
    """`fab inventory --json | true`: whenever Python writes it, no complaint."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        (str(FAB), *words),
        cwd=mine.folder,
        env=mine.environment,
        stdout=write,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


def test_nobody_reads_the_list_of_verbs(mine: Project) -> None:
    """`fleet --list | head -1`: Invoke prints that itself."""
    read, write = os.pipe()
    os.close(read)
    argv = (str(FAB.with_name("fleet")), "--list")
    done = subprocess.run(
        argv, cwd=mine.folder, env=mine.environment, stdout=write, stderr=subprocess.PIPE, check=False
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_reader_that_has_enough_is_no_error(mine: Project) -> None:
    """`fab run ... | head -1`: no traceback, and nobody goes on for it."""
    process = subprocess.Popen(
        (str(FAB), "run", "--limit", "0", "--hosts", "pi1", "--", "while echo line; do sleep 0.1; done"),
        cwd=mine.folder,
        env=mine.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout
    assert process.stderr
    assert process.stdout.readline() == b"pi1 | line\n"
    process.stdout.close()
    assert process.wait(timeout=30) == 0
    assert process.stderr.read() == b""
    process.stderr.close()


def test_the_project_is_found_from_a_folder_in_it(mine: Project) -> None:
    """`fab` looks upwards for its fabfile, and so does the inventory."""
    (mine.folder / "deep/er").mkdir(parents=True)
    assert mine.fab("run", "--hosts", "pi1", "--", "echo", "one", folder="deep/er").out == "pi1 | one\n"


def test_fleet_is_a_program_of_its_own(mine: Project, tmp_path: Path) -> None:
    """The same verbs in a folder that has an inventory and no fabfile."""
    (mine.folder / "fabfile.py").unlink()
    (mine.folder / "fabric.yaml").unlink()

    def fleet(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            (sys.executable, "-c", "from fleet.cli import main; main()", *words),
            cwd=tmp_path,
            env=mine.environment,
            capture_output=True,
            text=True,
            check=False,
        )

    assert fleet("run", "--hosts", "pi1", "--", "echo", "one").stdout == "pi1 | one\n"
    refused = fleet("-H", "pi1", "--", "uptime")
    assert (refused.returncode, refused.stdout) == (2, "")
    version = fleet("--version").stdout
    assert version.lower().startswith("fleet ")


@pytest.mark.parametrize(
    ("typed", "what", "cure"),
    [
        (("ship", "--hots", "pi1"), "ship has no flag --hots; did you mean --hosts?", "`fleet ship --help`"),
        (("ship", "--via"), "ship has no flag --via", "`fleet ship --help`"),
        (("ship", "--hosts"), "--hosts needs a value", "`fleet ship --help`"),
        (("ship", "--retry-for"), "--retry-for needs a value", "`fleet ship --help`"),
        (
            ("status", "pi1"),
            "status takes no words without a flag, such as pi1",
            "`fleet status --hosts pi1`",
        ),
        (
            ("completion", "--install=3"),
            "completion takes no words without a flag, such as 3",
            "`fleet completion",
        ),
        (("shp",), "there is no verb shp; did you mean ship?", "`fleet --list`"),
        (("-x", "ship"), "there is no verb -x", "`fleet --list`"),
        (("ship\x1b[2J",), "there is no verb ship", "`fleet --list`"),
    ],
)
def test_a_line_that_cannot_be_read(
    typed: tuple[str, ...],
    what: str,
    cure: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One sentence with the word that is wrong, and where to look; the exit code of a wrong command line."""
    monkeypatch.setattr("sys.argv", ["fleet", *typed])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(what)
    assert "\x1b" not in first
    assert second.startswith(f"  cure: {cure}")


def test_the_projects_own_fabfile_and_settings_name_our_executor() -> None:
    """Without it `fab -H NAME ship` would act on every robot."""
    assert "executor_class: fleet.cli.verb.Executor" in (ROOT / "fabric.yaml").read_text()
    assert os.access(FAB, os.X_OK)
