from __future__ import annotations

import os
import pty
import select
import shlex
import shutil
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet.cli import completions
from fleet.errors import DesktopError, UsageError
from tests.support.project import FAB, ROOT, Project

if TYPE_CHECKING:
    from pathlib import Path

INVENTORY = """\
stack: stack/compose.yaml
groups: {lidar: [pi1], arm: [pi2]}
robots:
  pi1:
  pi2: {stack: [stack/compose.yaml, My_Robot/compose.yaml]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project, and beside it the scripts for the shells."""
    folder = tmp_path_factory.mktemp("project")
    for name, text in (("stack", "name: talker\n"), ("My_Robot", "services: {}\n")):
        (folder / name).mkdir()
        (folder / name / "compose.yaml").write_text(text)
    (folder / "inventory.yaml").write_text(INVENTORY)
    (folder / "other.yaml").write_text("robots: {arm9: }\n")
    for shell in completions.SHELLS:
        done = Project(folder=folder, robots={}).fleet("completion", shell)
        assert done.code == 0
        (folder / f"completion.{shell}").write_text(done.out)
    return folder


def environment(folder: Path) -> dict[str, str]:
    path = f"{FAB.parent}:{os.environ['PATH']}"
    return {"PATH": path, "HOME": str(folder), "PYTHONPATH": str(ROOT), "TERM": "dumb", "LANG": "C.UTF-8"}


def completed(folder: Path, *words: str) -> list[str]:
    """What bash's completion function answers when these words are typed, the last one unfinished."""
    script = (
        f"source {folder}/completion.bash; COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _fleet;"
        ' printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ("bash", "--norc", "-c", script),
        cwd=folder,
        env=environment(folder),
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "answers"),
    [
        (["fleet", "sh"], ["shell", "ship"]),
        (["fleet", "lab.u"], ["lab.up"]),
        (["fleet", "ship", "--re"], ["--retry-for", "--renamed"]),
        (["fleet", "build", "--retry"], []),
        (["fleet", "ship", "--hosts", "p"], ["pi1", "pi2"]),
        (["fleet", "ship", "--hosts", "pi1,a"], ["pi1,arm", "pi1,all"]),
        (["fleet", "ship", "--hosts", "="], ["pi1", "pi2", "lidar", "arm", "all"]),
        (["fleet", "ship", "--hosts", "=", "li"], ["lidar"]),
        (["fleet", "ship", "--stack", ""], ["talker", "my_robot"]),
        (["fleet", "ship", "--inventory", "other.yaml", "--hosts", "ar"], ["arm9"]),
        (["fleet", "ship", "--inventory", "=", "other.yaml", "--hosts", "ar"], ["arm9"]),
        (["fleet", "ship", "--inventory", "none.yaml", "--hosts", ""], []),
        (["fleet", "ship", "--inventory", "oth"], ["other.yaml"]),
        (["fleet", "ship", "--prefer", "d"], ["desktop"]),
        (["fleet", "init", "--platform", "linux/arm6"], ["linux/arm64"]),
        (["fleet", "ship", "--limit", ""], []),
        (["fleet", "ship", "--dry", "--js"], ["--json"]),
        (["fleet", "run", "--", "sh"], []),
        (["fleet", "completion", "--shell", "f"], ["fish"]),
        (["fab", "sh"], []),
    ],
)
def test_bash_completes_what_is_typed(folder: Path, words: list[str], answers: list[str]) -> None:
    """Verbs, their flags, robots and groups after commas, stacks, files, and nothing after ``--``."""
    assert completed(folder, *words) == answers


def test_fab_is_completed_where_the_fabfile_is_ours(folder: Path, tmp_path: Path) -> None:
    """Other projects have a `fab` too."""
    shutil.copy(folder / "completion.bash", tmp_path)
    (tmp_path / "fabfile.py").write_text("from invoke import task\n")
    assert completed(tmp_path, "fab", "shi") == []
    shutil.copy(ROOT / "fabfile.py", tmp_path)
    assert completed(tmp_path, "fab", "shi") == ["ship"]


def typed(folder: Path, line: str, *, until: str) -> str:
    """What a terminal shows after these keys in a real bash, up to ``until`` or for 20 seconds."""
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.execvpe("bash", ["bash", "--norc", "--noprofile", "-i"], environment(folder))  # noqa: S606
    os.write(terminal, f"PS1='> '; source completion.bash; clear\n{line}".encode())
    shown, end = "", time.monotonic() + 20
    while until not in shown and time.monotonic() < end:
        if select.select([terminal], [], [], 0.2)[0]:
            shown += os.read(terminal, 4096).decode(errors="replace")
    os.write(terminal, b"\x15exit\n")
    os.close(terminal)
    os.waitpid(child, 0)
    return shown


def test_the_tab_key_completes_in_a_terminal(folder: Path) -> None:
    """A person's bash: a verb, a flag and a group, with one Tab each."""
    shown = typed(folder, "fleet shi\t--ho\tlid\t", until="fleet ship --hosts lidar ")
    assert "fleet ship --hosts lidar " in shown


@pytest.mark.parametrize("shell", completions.SHELLS)
def test_a_script_has_every_verb_and_flag(folder: Path, shell: str) -> None:
    """And the shell can read it, if it is installed here."""
    text = (folder / f"completion.{shell}").read_text()
    ship = text[text.index("ship") :]
    assert {name for name in ("lab.up", "provision", "retry-for", "renamed") if name not in ship} == set()
    assert "@" not in text.replace('"$@"', "").replace("[@]", "")
    if found := shutil.which(shell):
        done = subprocess.run(
            (found, "-n", str(folder / f"completion.{shell}")), capture_output=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, b"")


def test_the_script_for_bash_is_sound(folder: Path) -> None:
    """shellcheck has no complaints."""
    lint = (str(FAB.with_name("shellcheck")), str(folder / "completion.bash"))
    done = subprocess.run(lint, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home of one's own."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.mark.parametrize(
    ("shell", "places"),
    [
        (
            "bash",
            [
                ".local/share/bash-completion/completions/fleet",
                ".local/share/bash-completion/completions/fab",
            ],
        ),
        ("zsh", [".local/share/zsh/site-functions/_fleet"]),
        ("fish", [".config/fish/completions/fleet.fish", ".config/fish/completions/fab.fish"]),
    ],
)
def test_a_script_is_installed_where_the_shell_looks(home: Path, shell: str, places: list[str]) -> None:
    """Twice: the second time it is brought up to date."""
    mine = Project(folder=home, robots={})
    for _ in range(2):
        done = mine.fleet("completion", shell, "--install")
        assert done.code == 0
        assert [f"wrote {home / place}" in done.err for place in places] == [True] * len(places)
        assert "compinit" in done.err if shell == "zsh" else "it works in new terminals" in done.err
        (home / places[0]).write_text((home / places[0]).read_text() + "# old\n")
    assert mine.fleet("completion", shell, "--install").code == 0
    assert (home / places[0]).read_text() == mine.fleet("completion", "--shell", shell).out


def test_a_file_of_somebody_else_stays(home: Path) -> None:
    """Another program's completion of `fab`, or a person's own."""
    path = home / ".config/fish/completions/fleet.fish"
    path.parent.mkdir(parents=True)
    path.write_text("# mine\n")
    with pytest.raises(DesktopError, match="is there and is not fleet's"):
        list(completions.install("fish", "new"))
    assert path.read_text() == "# mine\n"


def test_the_shell_is_the_login_s(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless one is named; others are refused."""
    monkeypatch.setenv("SHELL", "/usr/bin/zsh")
    assert (completions.shell(""), completions.shell("fish")) == ("zsh", "fish")
    for named, login in (("csh", ""), ("", ""), ("", "/bin/dash")):
        monkeypatch.setenv("SHELL", login)
        with pytest.raises(UsageError):
            completions.shell(named)


def test_names_that_cannot_be_had_are_none(tmp_path: Path) -> None:
    """The Tab key prints no errors; a kind that does not exist is a mistake."""
    assert completions.names("hosts", str(tmp_path / "none.yaml")) == []
    assert completions.names("stack", str(tmp_path / "none.yaml")) == []
    with pytest.raises(UsageError, match="--names takes hosts or stack"):
        completions.names("robots", "")
