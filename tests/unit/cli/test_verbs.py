from __future__ import annotations

import json
import re
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet import cli
from fleet.cli import deploy, lab, observe
from fleet.cli.selection import select
from fleet.errors import InventoryError
from tests.support import project
from tests.support.project import FAB, Project
from tests.support.sshd import Sshds, known_line, make_key, public_key

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

VERBS = {
    *("inventory", "trust", "provision", "build", "ship", "rollback", "history", "start", "stop", "restart"),
    *("status", "logs", "run", "shell", "listen", "lab.up", "lab.down", "lab.list", "prune"),
}


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory, desktop: None) -> Iterator[Project]:  # noqa: ARG001
    """A project with two robots and one that is away. Tests that share it change nothing in it."""
    sshds = Sshds(tmp_path_factory.mktemp("project"))
    yield project.make(sshds, "pi1", "pi2")
    sshds.stop()


@pytest.fixture
def own(sshds: Sshds) -> Project:
    """A project of the test's own, with one robot and one that is away."""
    return project.make(sshds, "pi1")


def test_the_list_of_verbs(mine: Project) -> None:
    """Each with one line that fits the terminal, and quickly: no SDK is loaded for it."""
    done = mine.fab("--list")
    listed = dict(re.findall(r"^  (\S+) +(\S.*)$", done.out, flags=re.MULTILINE))
    assert (done.code, done.err, set(listed)) == (0, "", VERBS)
    assert max(len(line) for line in done.out.splitlines()) <= 80


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
def test_each_verb_has_help_with_a_meaning_for_every_flag(verb: str) -> None:
    """A flag without a word of explanation is a riddle."""
    for flag in cli.ns[verb].get_arguments():
        assert flag.help, f"{verb} --{flag.name}"
    docstring = cli.ns[verb].__doc__ or ""
    assert docstring.splitlines()[0].endswith(".")
    assert len(docstring.splitlines()[0]) < 60


@pytest.mark.parametrize(
    "verb", sorted(VERBS - {"inventory", "status", "history", "logs", "listen", "lab.list"})
)
def test_each_verb_that_changes_something_can_be_asked_first(verb: str) -> None:
    """The lab's are refused with --dry, all others show what they would do."""
    flags = {name for argument in cli.ns[verb].get_arguments() for name in argument.names}
    assert "dry" in flags or verb.startswith("lab.")


def test_the_help_of_a_verb_as_it_is_asked_for(mine: Project) -> None:
    """Both ways that Fabric knows, each in a process of its own: Invoke forgets the flags' help once it is shown."""
    help_page = mine.fab("ship", "--help").out
    assert help_page == mine.fab("--help", "ship").out
    assert "--hosts=STRING" in help_page


def test_the_verbs_are_all_those_of_the_modules() -> None:
    """Nobody adds one and forgets to list it."""
    modules = (deploy, observe, lab)
    assert sum(len(module.VERBS) for module in modules) == len(VERBS) == len(cli.ns.task_names)


BAD = [
    (
        ("run", "--hosts", "pj1", "--", "true"),
        2,
        "--hosts pj1: no such robot or group\n  cure: did you mean 'pi1'?",
    ),
    (("run", "--hosts", ",", "--", "true"), 2, "--hosts is empty"),
    (("run", "--hosts", "x*", "--", "true"), 2, "matches no robot"),
    (("run",), 2, "there is no command to run\n  cure: fab run --hosts NAMES -- COMMAND"),
    (("run", "--limit", "soon", "--", "true"), 2, "--limit takes a whole number, not soon"),
    (("history", "--tail", "x"), 2, "--tail takes a whole number, not x"),
    (("shell",), 2, "a shell goes to one robot, and all names 3"),
    (("shell", "--hosts", "fleet"), 2, "a shell goes to one robot, and fleet names 2"),
    (("status", "--inventory", "none.yaml"), 2, "none.yaml"),
    (("status", "--inventory", "."), 2, "."),
    (("status", "--inventory", "/dev/null"), 2, "/dev/null"),
    (
        ("ship", "--hosts", "pi1"),
        2,
        "there is no image fleet-test-none for linux/arm64 here\n  cure: run `fab build`",
    ),
    (("lab.down", "--dry"), 2, "nothing was done"),
    (("--dry", "lab.up"), 2, "nothing was done"),
    (("lab.up", "--count", "many"), 2, "--count takes a whole number, not many"),
    (("--hosts", "pi1", "ship"), 2, "--hosts comes after the task: fab ship --hosts pi1"),
    (("build", "--", "x"), 2, "only `run` takes a command after `--`"),
    (("shp",), 1, "No idea what 'shp' is!"),
    (("ship", "--foo"), 1, "No idea what '--foo' is!"),
    (("ship", "--hosts"), 1, "needed value"),
    (("run", "--hosts", "away", "--", "true"), 1, "away: 127.0.0.1 refuses connections to port"),
    (("run", "--hosts", "pi1", "--", "exit 7"), 1, "pi1: ended with code 7"),
    (("listen", "--hosts", "pi1", "--count", "1"), 1, "pi1: no ROS master listens at"),
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


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "inventory.yaml"),
        ("robots: [\n", "inventory.yaml"),
        ("robots:\n  pi1:\n    adress: x\n", "3: robots.pi1.adress: no such key; did you mean 'address'?"),
        ("robots:\n  pi1: {port: 0}\nstak: x\n", "2 problems"),
        ("stack: none.yaml\nrobots: {pi1: pi1.local}\n", "none.yaml"),
        ("robots: {}\n", "names no robots"),
    ],
)
def test_a_bad_inventory_is_refused(own: Project, text: str, what: str) -> None:
    """With file, line, key and cure; before anybody is called."""
    (own.folder / "inventory.yaml").write_text(text)
    done = own.fleet("ship")
    assert (done.code, done.out) == (2, "")
    assert what in done.err
    assert "Traceback" not in done.err


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


def test_the_inventory_of_the_environment(mine: Project, tmp_path: Path) -> None:
    """$FLEET_INVENTORY names one, --inventory another that comes first."""
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(f"robots: {{{name}: {name}.local}}\n")
    one, two = str(tmp_path / "one.yaml"), str(tmp_path / "two.yaml")
    assert mine.fab("inventory", FLEET_INVENTORY=one).out.startswith("one\n")
    assert mine.fab("inventory", "--inventory", two, FLEET_INVENTORY=one).out.startswith("two\n")


def test_robots_are_selected_by_name_group_wildcard_and_list(mine: Project) -> None:
    """In the order of the inventory, each once."""
    for hosts, names in (
        ("pi2", ["pi2"]),
        ("fleet", ["pi1", "pi2"]),
        ("pi?,pi1", ["pi1", "pi2"]),
        ("away,pi1", ["pi1", "away"]),
        ("all", ["pi1", "pi2", "away"]),
    ):
        said = json.loads(mine.fleet("inventory", "--json", "--hosts", hosts).out)
        assert [robot["name"] for robot in said] == names


def test_the_nearest_inventory_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Upwards from where the person is; none at all is refused."""
    (tmp_path / "deep/er").mkdir(parents=True)
    (tmp_path / "inventory.yaml").write_text("robots: {outer: outer.local}\n")
    monkeypatch.delenv("FLEET_INVENTORY", raising=False)
    monkeypatch.chdir(tmp_path / "deep/er")
    assert [robot.name for robot in select("", "all")[1]] == ["outer"]
    (tmp_path / "deep/inventory.yaml").write_text("robots: {inner: inner.local}\n")
    assert [robot.name for robot in select("", "all")[1]] == ["inner"]
    monkeypatch.chdir("/")
    with pytest.raises(InventoryError, match=r"inventory\.yaml"):
        select("", "all")


def test_a_command_on_all_robots(mine: Project) -> None:
    """Lines with names on standard output, what went wrong on standard error."""
    done = mine.fab("run", "--", "pwd")
    assert sorted(done.out.splitlines()) == [f"{n}  | {mine.robots[n].path}" for n in ("pi1", "pi2")]
    assert done.err.startswith("away: 127.0.0.1 refuses connections to port ")
    assert done.code == 1


@pytest.mark.parametrize(
    "words",
    [
        ("--dry", "run", "--", "touch made"),
        ("run", "--dry", "--hosts", "pi1", "--", "touch made"),
        ("run", "--hosts", "pi1", "--dry", "--command", "touch made"),
        ("start", "--dry"),
        ("--dry", "stop"),
        ("trust", "--dry", "--yes"),
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


def test_a_dry_run_of_a_command_shows_it(mine: Project) -> None:
    """On each robot that would run it."""
    assert (
        mine.fleet("run", "--dry", "--hosts", "fleet", "--", "reboot").out == "pi1: $ reboot\npi2: $ reboot\n"
    )


def test_a_dry_run_of_a_build_shows_the_commands(mine: Project) -> None:
    """For the platforms of the robots that are meant."""
    done = mine.fleet("build", "--dry")
    assert done.code == 0
    assert "build fleet-test-none:latest-arm64 for linux/arm64\n  $ " in done.out
    assert " --platform linux/arm64 --tag fleet-test-none:latest-arm64 " in done.out


def test_trust_records_what_a_person_says_yes_to(own: Project) -> None:
    """Unknown: nobody there is a no, --yes is a yes, and the second time it is known."""
    (own.folder / "known_hosts").unlink()
    refused = own.fleet("trust", "--hosts", "pi1")
    assert (refused.code, (own.folder / "known_hosts").exists()) == (1, False)
    assert "was not recorded: ssh-ed25519 SHA256:" in refused.out
    assert own.fleet("trust", "--hosts", "pi1", "--dry").out.startswith(
        "pi1  unchanged    would record ssh-ed25519"
    )
    assert own.fleet("run", "--hosts", "pi1", "--", "true").code == 1
    recorded = own.fleet("trust", "--hosts", "pi1", "--yes")
    assert (recorded.code, recorded.out[:24]) == (0, "pi1  done         record")
    assert own.fleet("trust", "--hosts", "pi1").out.startswith("pi1  unchanged    known ssh-ed25519 SHA256:")
    assert own.fleet("run", "--hosts", "pi1", "--", "true").code == 0


def test_a_changed_key_is_refused_by_every_verb_and_replaced_on_demand(own: Project) -> None:
    """--yes alone does not: somebody may be in the middle."""
    server = own.robots["pi1"].server
    other = public_key(make_key(own.folder / "other"))
    server.known_hosts.write_text(known_line(server.known_as, other))
    for words in (("run", "--", "true"), ("start",), ("status",), ("trust", "--yes")):
        done = own.fleet(words[0], "--hosts", "pi1", *words[1:])
        assert done.code == 1
        assert "changed" in (done.out + done.err).lower()
    assert own.fleet("trust", "--hosts", "pi1", "--yes", "--changed").code == 0
    assert own.fleet("run", "--hosts", "pi1", "--", "true").code == 0


def test_status_of_robots_to_which_nothing_was_shipped(mine: Project) -> None:
    """A row each; the one that is away makes the code 1, the others do not."""
    done = mine.fleet("status")
    rows = [line.split() for line in done.out.splitlines()]
    assert rows[0][:4] == ["robot", "reachable", "release", "containers"]
    assert [row[:2] for row in rows[1:]] == [["pi1", "yes"], ["pi2", "yes"], ["away", "no"]]
    assert done.code == 1
    assert mine.fleet("status", "--hosts", "fleet").code == 0


def test_history_is_told_by_robot_and_time(own: Project) -> None:
    """The last so many of each; 0 is none."""
    home = own.robots["pi1"].path
    (home / ".fleet").mkdir()
    lines = [f"2026-11-23T12:0{number}:00Z\tship\tr{number}\ttim@desktop\tdone" for number in range(5)]
    (home / ".fleet/history").write_text("\n".join(lines) + "\n")
    done = own.fleet("history", "--hosts", "pi1", "--tail", "2")
    assert [line.split() for line in done.out.splitlines()[1:]] == [
        ["pi1", "2026-11-23", f"12:0{number}:00", "ship", f"r{number}", "tim@desktop", "done"]
        for number in (3, 4)
    ]
    assert len(json.loads(own.fleet("history", "--hosts", "pi1", "--json").out)["pi1"]) == 5
    assert len(own.fleet("history", "--hosts", "pi1", "--tail", "0").out.splitlines()) == 1


def test_a_shell_is_openssh_with_the_recorded_keys(own: Project) -> None:
    """The very words, and they lead in; an unknown robot is refused by OpenSSH too."""
    words = own.fab("shell", "--hosts", "pi1", "--dry").out
    assert words.startswith("ssh ")
    assert str(own.folder / "known_hosts") in words
    assert "StrictHostKeyChecking=yes" in words
    done = subprocess.run(
        (str(FAB), "shell", "--hosts", "pi1"),
        cwd=own.folder,
        env=own.environment,
        input="",
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, "Accepted" in own.robots["pi1"].server.log.read_text()) == (0, True)
    (own.folder / "known_hosts").unlink()
    assert own.fab("shell", "--hosts", "pi1").code == 255


def test_a_live_status_goes_on_until_ctrl_c(own: Project) -> None:
    """It draws the table again and again, and ends well."""
    home = own.robots["pi1"]
    process = subprocess.Popen(
        (str(FAB), "status", "--watch", "--hosts", "pi1"),
        cwd=own.folder,
        env=own.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 30
    while home.logins < 2:  # one look, then the connection that stays
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(0.2)
    process.send_signal(2)
    out, err = process.communicate(timeout=15)
    assert (process.returncode, err) == (0, "")
    assert "pi1" in out
