from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from fleet import cli
from fleet.cli import overview
from tests.support.project import ROOT, Project

if TYPE_CHECKING:
    from pathlib import Path

SHOWN = [
    "Set up\n  init              Write the files",
    "\nShip\n  build  ",
    "\nLook\n  status  ",
    "\nLab: virtual robots on this computer\n  lab.up  ",
    *(f"\n  {flag}  " for flag in ("--hosts NAMES", "--dry", "--json", "--inventory FILE", "--help")),
    "\nDocumentation: README.md and docs/",
]


def listed(out: str) -> dict[str, str]:
    """The verbs that ``fab --list`` printed, with their summaries."""
    return dict(re.findall(r"^  (\S+) +(\S.*)$", out, flags=re.MULTILINE))


@pytest.mark.parametrize("words", [(), ("help",), ("--help",), ("-h",)])
def test_fleet_without_a_verb_shows_the_overview(mine: Project, words: tuple[str, ...]) -> None:
    """With the name that was typed, and none of Fabric's flags."""
    done = mine.fleet(*words)
    assert (done.code, done.err) == (0, "")
    assert [part for part in SHOWN if part not in done.out] == []
    assert "Usage: fleet VERB" in done.out
    assert "--prompt-for" not in done.out
    assert max(len(line) for line in done.out.splitlines()) <= 90


@pytest.mark.parametrize("words", [(), ("help",)])
def test_fab_without_a_verb_shows_the_overview(mine: Project, words: tuple[str, ...]) -> None:
    """Fabric has its own page for a bare ``--help``, which a fabfile cannot change."""
    done = mine.fab(*words)
    assert (done.code, done.err) == (0, "")
    assert "Usage: fab VERB" in done.out
    assert [part for part in SHOWN if part not in done.out] == []


@pytest.mark.parametrize("words", [(), ("help",), ("--help",)])
def test_a_folder_without_an_inventory_is_told_how_to_begin(tmp_path: Path, words: tuple[str, ...]) -> None:
    """First of all; the same folder with an inventory, here or above, needs no such words."""
    folder = tmp_path / "new"
    folder.mkdir()
    new = Project(folder=folder, robots={})
    done = new.fleet(*words)
    assert (done.code, done.err) == (0, "")
    assert done.out.index("There is no inventory in this folder.") < done.out.index("Set up\n")
    assert re.findall(r"^  fleet (init|init --example|lab.up)  ", done.out, flags=re.MULTILINE) == [
        "init",
        "init --example",
        "lab.up",
    ]
    (tmp_path / "inventory.yaml").touch()
    assert "There is no inventory" not in new.fleet(*words).out


def test_every_verb_has_one_place_in_the_overview() -> None:
    """A new verb without a purpose fails here."""
    names = [name for verbs in overview.PURPOSES.values() for name in verbs]
    assert sorted([*names, "help"]) == sorted(cli.ns.task_names)


def test_the_list_of_verbs(mine: Project) -> None:
    """Each with one line that fits the terminal."""
    done = mine.fab("--list")
    assert (done.code, done.err, set(listed(done.out))) == (0, "", set(cli.ns.task_names))
    assert max(len(line) for line in done.out.splitlines()) <= 80


def test_the_readme_has_every_verb_of_the_list_and_no_other(mine: Project) -> None:
    """A cell may hold several verbs; `help` needs no row."""
    cells = re.findall(
        r"^\| (`fab [^|]+) \|", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    rows = {name for cell in cells for name in re.findall(r"`(?:fab )?([\w.]+)[^`]*`", cell)}
    assert rows == set(listed(mine.fab("--list").out)) - {"help"}


def test_the_help_of_a_verb_as_it_is_asked_for(mine: Project) -> None:
    """Both ways that Fabric knows, each in a process of its own: Invoke shows the flags' help only once."""
    help_page = mine.fab("ship", "--help").out
    assert help_page == mine.fab("--help", "ship").out
    assert "--hosts=STRING" in help_page
    words = " ".join(help_page.split())
    assert "If the connection drops, the transfer resumes where it stopped." in words
