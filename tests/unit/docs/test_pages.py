from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from fleet import cli

ROOT = Path(__file__).parents[3]
PAGES = sorted(
    path for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")) if path.name != "CHANGELOG.md"
)
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")

_FENCED = re.compile(r"^( *)```(?:sh|console|text)?\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"^ {4,}(.+)$", re.MULTILINE)
_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def commands(page: str, program: str) -> list[str]:
    """The lines and spans of code that begin with a program, each up to what a shell would end it with."""
    blocks = "\n".join(body for _, body in _FENCED.findall(page))
    rest = _FENCED.sub("", page)
    code = [*blocks.splitlines(), *_INDENTED.findall(rest), *_SPAN.findall(rest)]
    lines = (line.strip().removeprefix("$ ") for line in code)
    parts = (part.strip() for line in lines for part in re.split(r"&&|\||;|  +#", line))
    return [part for part in parts if part.startswith(f"{program} ")]


def anchors(page: str) -> set[str]:
    """The names that GitHub gives to headings."""
    headings = re.findall(r"^#+ (.+)$", page, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path: Path) -> None:
    """A link within the project names a file that is there, and a heading of it."""
    for link in _LINK.findall(_FENCED.sub("", text(path))):
        if re.match(r"https?:|mailto:", link):
            continue
        name, _, heading = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), link
        assert not heading or heading in anchors(text(target)), link


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
@pytest.mark.parametrize("program", ["fab", "fleet"])
def test_commands_exist(path: Path, program: str) -> None:
    """Every verb that a page types exists, and has the flags that are typed with it."""
    for command in commands(text(path), program):
        words = shlex.split(command.partition(" -- ")[0].replace("'", '"'))[1:]
        verbs = [word for word in words[:1] if not word.startswith("-") and not word.isupper()]
        for verb in verbs:
            assert set(verb.rstrip(",").split("/")) <= set(cli.ns.task_names), command
            flags = {flag for argument in cli.ns[verb].get_arguments() for flag in argument.names}
            typed = {word.partition("=")[0][2:] for word in words if word.startswith("--") and len(word) > 2}
            assert typed - {"help"} <= flags, command


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_make_targets_exist(path: Path) -> None:
    """Every `make` target that a page types is one of the Makefile."""
    for command in commands(text(path), "make"):
        target = command.split()[1]
        assert target.isupper() or re.search(rf"^{re.escape(target)}:", MAKEFILE, flags=re.MULTILINE), command


def test_every_verb_is_in_the_readme() -> None:
    """The table of verbs and `fab --list` agree; `help` is what `fab` alone shows."""
    cells = re.findall(r"^\| (`fab .+?) \|", text(ROOT / "README.md"), flags=re.MULTILINE)
    named = {
        name.removeprefix("fab ").split()[0] for cell in cells for name in _SPAN.findall(cell) if name != "--"
    }
    assert named == set(cli.ns.task_names) - {"help"}


def test_every_page_can_be_reached_from_the_readme() -> None:
    """Whoever reads the README finds each page by links."""
    seen: set[Path] = set()
    todo = {ROOT / "README.md"}
    while todo:
        seen |= todo
        links = {
            (page.parent / link.partition("#")[0]).resolve()
            for page in todo
            for link in _LINK.findall(text(page))
        }
        todo = {link for link in links if link.suffix == ".md" and link.exists()} - seen
    assert {path.resolve() for path in PAGES} - seen == set()
