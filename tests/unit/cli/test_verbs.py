from __future__ import annotations

import json
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import cli
from fleet.cli import build, bundle, card, ci, deploy, dev, find, lab, observe, project, push
from tests.support.project import FAB

if TYPE_CHECKING:
    from tests.support.project import Project


VERBS = {
    *("inventory", "trust", "provision", "build", "ship", "rollback", "history", "start", "stop", "restart"),
    *("init", "completion", "remove", "topics", "bundle", "dev", "push"),
    *("status", "logs", "run", "shell", "listen", "lab.up", "lab.down", "lab.list", "prune", "help"),
    *("card", "await", "find", "ci.github", "ci.shell"),
}


def test_listing_verbs_loads_nothing_heavy(mine: Project) -> None:
    """The Docker SDK takes up to 0.8 s to load, pydantic a quarter of the rest."""
    script = "import sys, fleet.cli; print({'docker', 'pydantic'} & set(sys.modules))"
    done = subprocess.run(
        (FAB.with_name("python"), "-c", script),
        env=mine.environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "set()\n"


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_each_verb_has_a_short_summary(verb: str) -> None:
    """One sentence, which fits the list of verbs."""
    summary = (cli.ns[verb].__doc__ or "").partition("\n")[0]
    assert summary.endswith(".")
    assert len(summary) < 60


def test_each_flag_has_help(mine: Project) -> None:
    """Asked in a process of its own, because Invoke forgets a flag's help when it has been read once."""
    script = (
        "from fleet.cli import ns;"
        "print([(v, f.name) for v in ns.task_names for f in ns[v].get_arguments() if not f.help])"
    )
    done = subprocess.run(
        (FAB.with_name("python"), "-c", script),
        env=mine.environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[]\n"


@pytest.mark.parametrize(
    "verb",
    sorted(
        VERBS
        - {
            "inventory",
            "status",
            "history",
            "logs",
            "listen",
            "topics",
            "lab.list",
            "help",
            "completion",
            "await",
            "find",
            "ci.shell",
        }
    ),
)
def test_each_verb_that_changes_something_can_be_asked_first(verb: str) -> None:
    """The lab's are refused with --dry, all others show what they would do."""
    flags = {name for argument in cli.ns[verb].get_arguments() for name in argument.names}
    assert "dry" in flags or verb.startswith("lab.")


def test_the_verbs_are_all_those_of_the_modules() -> None:
    """Nobody adds one and forgets to list it."""
    modules = (build, bundle, card, ci, deploy, dev, find, observe, lab, project, push)
    assert (
        sum(len(module.VERBS) for module in modules) + len(("help", "completion"))
        == len(VERBS)
        == len(cli.ns.task_names)
    )


BAD = [
    (
        ("run", "--hosts", "pj1", "--", "true"),
        2,
        "--hosts pj1: no such robot or group\n  cure: did you mean 'pi1'?",
    ),
    (("run", "--hosts", ",", "--", "true"), 2, "--hosts is empty"),
    (("run", "--hosts", "x*", "--", "true"), 2, "matches no robot"),
    (("run",), 2, "no command was given\n  cure: fleet run --hosts NAMES -- COMMAND"),
    (("run", "--limit", "soon", "--", "true"), 2, "--limit takes a whole number, not soon"),
    (("history", "--tail", "x"), 2, "--tail takes a whole number, not x"),
    (("shell",), 2, "`fleet shell` opens one robot, but all names 3"),
    (("shell", "--hosts", "fleet"), 2, "`fleet shell` opens one robot, but fleet names 2"),
    (("status", "--inventory", "none.yaml"), 2, "none.yaml"),
    (("status", "--inventory", "."), 2, "."),
    (("status", "--inventory", "/dev/null"), 2, "/dev/null"),
    (
        ("ship", "--hosts", "pi1"),
        2,
        "there is no image fleet-test-none for linux/arm64 here\n  cure: run `fleet build`",
    ),
    (("--hosts", "pi1"), 2, "--hosts comes after the task: fleet VERB --hosts pi1"),
    (
        ("--pty", "ship"),
        2,
        "--pty has no effect here: `fleet shell --hosts NAME` opens a terminal on a robot",
    ),
    (("ship", "-i", "key"), 2, "--identity has no effect here: set `identity_file` in the inventory"),
    (("-T", "5", "status"), 2, "--command-timeout has no effect here: `fleet run --limit SECONDS"),
    (("-w",), 2, "--warn-only has no effect here"),
    (("--hosts", "pi1", "ship"), 2, "--hosts comes after the task: fleet ship --hosts pi1"),
    (("build", "--", "x"), 2, "only `run` takes a command after `--`"),
    (("shp",), 2, "there is no verb shp; did you mean ship?"),
    (("ship", "--foo"), 2, "ship has no flag --foo"),
    (("ship", "--hosts"), 2, "--hosts needs a value"),
    (("run", "--hosts", "away", "--", "true"), 1, "away: 127.0.0.1 refuses connections to port"),
    (("run", "--hosts", "pi1", "--", "exit 7"), 1, "pi1: ended with code 7"),
    (("topics", "--hosts", "pi1"), 1, "pi1: no ROS master listens at"),
    (("listen", "--hosts", "pi1", "--count", "1"), 1, "pi1: no ROS master listens at"),
    (
        ("listen", "--timeout", "0"),
        2,
        "--timeout 0 leaves no time to find anything\n  cure: say --timeout 10, or",
    ),
    (("topics", "--timeout", "0"), 2, "--timeout 0 leaves no time"),
    (("listen", "--via", "pi1"), 2, "--via pi1 is not possible\n  cure: say --via robot, or leave it out"),
    (("start", "--hosts", "away"), 1, "1 unreachable"),
]


@pytest.mark.parametrize(("words", "code", "err"), BAD, ids=[" ".join(words) for words, _, _ in BAD])
def test_what_goes_wrong_is_said_in_a_sentence(
    mine: Project, words: tuple[str, ...], code: int, err: str
) -> None:
    """2 is the person's mistake, 1 is the world's; never a traceback. (What Fabric's own parser refuses is 1.)"""
    done = mine.fleet(*words)
    assert err in done.err
    assert "Traceback" not in done.err
    assert done.code == code


JSON = [
    (("inventory",), 0),
    (("status", "--hosts", "pi1,away"), 1),
    (("history", "--hosts", "pi1"), 0),
    (("trust",), 1),
    (("start",), 1),
    (("stop", "--dry"), 1),
    (("restart",), 1),
    (("rollback", "--hosts", "fleet"), 1),
    (("build", "--dry"), 0),
]


@pytest.mark.parametrize(("words", "code"), JSON, ids=[" ".join(words) for words, _ in JSON])
def test_json_is_json_alone(mine: Project, words: tuple[str, ...], code: int) -> None:
    """Whatever happens, standard output is one value that a program can read."""
    done = mine.fleet(*words, "--json")
    assert json.loads(done.out)
    assert done.code == code


def test_what_is_piped_has_no_escape_codes(mine: Project) -> None:
    """Neither results nor progress, whatever the terminal is said to be."""
    for words in (
        ("inventory",),
        ("status",),
        ("trust",),
        ("start",),
        ("run", "--", "printf '\\033[31mred\\n'"),
    ):
        done = mine.fab(*words, TERM="xterm-256color", COLUMNS="40")
        assert "\x1b" not in done.out + done.err
        assert "\r" not in done.out + done.err


@pytest.mark.parametrize(
    "words",
    [
        ("--dry", "run", "--", "touch made"),
        ("run", "--dry", "--hosts", "pi1", "--", "touch made"),
        ("run", "--hosts", "pi1", "--dry", "--command", "touch made"),
        ("start", "--dry"),
        ("--dry", "stop"),
        ("trust", "--dry", "--yes"),
        ("init", "--dry", "--yes"),
        ("rollback", "--to", "x", "--dry"),
        ("build", "--dry"),
        ("shell", "--hosts", "pi1", "--dry"),
        ("status", "--dry"),
    ],
)
def test_a_dry_run_changes_nothing(mine: Project, words: tuple[str, ...]) -> None:
    """Not a file in the project, not one on a robot."""

    def state() -> dict[str, tuple[int, int]]:
        files = (path for path in mine.folder.rglob("*") if path.is_file() and path.name != "log")
        return {str(path): (path.stat().st_mtime_ns, path.stat().st_size) for path in files}

    before = state()
    assert "Traceback" not in mine.fleet(*words).err
    assert state() == before
