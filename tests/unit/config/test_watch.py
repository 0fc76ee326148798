from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from fleet.config.compose import Project, Resolved
from fleet.config.stack import Stack, read
from fleet.config.watch import Hook, Patterns, Rule, rules
from fleet.errors import ComposeError

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("lines", "path", "matches"),
    [
        (["*.pyc"], "a.pyc", True),
        (["*.pyc"], "a/b.pyc", False),
        (["**/*.pyc"], "a/b.pyc", True),
        (["**/*.pyc"], "b.pyc", True),
        (["/node_modules/"], "node_modules/x/y.js", True),
        (["node_modules"], "x/node_modules", False),
        (["a?c"], "abc", True),
        (["a?c"], "a/c", False),
        (["[ab].txt"], "b.txt", True),
        (["[^ab].txt"], "b.txt", False),
        (["a/**"], "a/b/c", True),
        (["a/**/c"], "a/c", True),
        (["*", "!talker", "talker/test"], "talker/src/a.py", False),
        (["*", "!talker", "talker/test"], "talker/test/a.py", True),
        (["*", "!talker", "talker/test"], "docs/a.md", True),
        (["# a comment", ""], "# a comment", False),
        (["a+b.(x)"], "a+b.(x)", True),
        ([], "a", False),
    ],
)
def test_patterns_are_those_of_dockerignore(lines: list[str], path: str, matches: bool) -> None:
    """Relative to one folder; a folder that matches takes what is in it; the last pattern decides."""
    assert Patterns(lines).match(path) is matches


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The project's folder, with a context beside it."""
    for path in ("robot/x", "nav/src/deep", "nav/test"):
        (tmp_path / path).mkdir(parents=True)
    for path in ("nav/src/a.py", "nav/src/deep/b.py", "nav/test/t.py", "nav/package.xml", "robot/nav.yaml"):
        (tmp_path / path).write_text("x")
    return tmp_path / "robot"


def stack(folder: Path, *watched: dict[str, Any], **service: Any) -> tuple[Stack, Project]:  # noqa: ANN401
    (folder / "compose.yaml").write_text("services:\n  node:\n    develop:\n      watch: []\n")
    project = Project(
        files=(folder / "compose.yaml",), real=folder, folder=folder.parent.joinpath(*["up"] * 24, "robot")
    )
    above = project.folder.parent
    model = {"name": "robot", "services": {"node": {"image": "x", "develop": {"watch": [
        {**one, "path": f"{above}/{one['path']}"} for one in watched
    ]}, **service}}}  # fmt: skip
    return read(Resolved(model=model), project), project


def found(folder: Path, *watched: dict[str, Any], **service: Any) -> tuple[Rule, ...]:  # noqa: ANN401
    return rules(*stack(folder, *watched, **service))


def test_each_entry_becomes_a_rule(folder: Path) -> None:
    """As Compose's canonical model writes them, with the empty `exec` that it adds."""
    nav = str(folder.parent / "nav")
    empty = {"command": None}
    assert found(
        folder,
        {"action": "sync", "path": "nav/src", "target": "/app", "exec": empty, "initial_sync": True, "ignore": ["*.md"], "include": ["**/*.py"]},
        {"action": "sync+restart", "path": "nav/src/a.py", "target": "/app/a.py", "exec": empty},
        {"action": "sync+exec", "path": "nav/test", "target": "/t", "exec": {"command": ["kill", "-HUP", "$$1"], "user": "root", "working_dir": "/", "environment": {"A": "b", "C": None}}},
        {"action": "restart", "path": "nav/package.xml", "exec": empty},
        {"action": "rebuild", "path": "nav", "exec": empty},
    ) == (
        Rule(service="node", action="sync", path=f"{nav}/src", target="/app", initial=True, ignored=Patterns(["*.md"]), only=Patterns(["**/*.py"])),
        Rule(service="node", action="sync+restart", path=f"{nav}/src/a.py", target="/app/a.py"),
        Rule(service="node", action="sync+exec", path=f"{nav}/test", target="/t", hook=Hook(command=("kill", "-HUP", "$1"), user="root", folder="/", environment=(("A", "b"),))),
        Rule(service="node", action="restart", path=f"{nav}/package.xml"),
        Rule(service="node", action="rebuild", path=nav),
    )  # fmt: skip


def test_a_rule_takes_what_is_below_it(folder: Path) -> None:
    """But for what it ignores, what the build ignores, and what editors and git leave; a file that it names counts always."""
    (folder.parent / ".dockerignore").write_text("*\n!nav\n**/deep\nnav/package.xml\n")
    build = {"context": str(folder.parent.joinpath(*["up"] * 24)), "dockerfile": "Dockerfile"}
    nav = str(folder.parent / "nav")
    whole, named = found(
        folder,
        {"action": "sync", "path": "nav", "target": "/app", "ignore": ["test"]},
        {"action": "rebuild", "path": "nav/package.xml"},
        build=build,
    )
    taken = {
        name: whole.takes(f"{nav}/{name}")
        for name in ("src/a.py", "src/deep/b.py", "test/t.py", "package.xml", ".git/x", "src/.a.py.swp", "src/a.py~", "src/4913")
    }  # fmt: skip
    assert taken == {**dict.fromkeys(taken, False), "src/a.py": True}
    assert whole.place(f"{nav}/src/a.py") == "/app/src/a.py"
    assert not whole.takes(f"{nav}igation/x")
    assert named.takes(f"{nav}/package.xml")
    assert not whole.prunes(f"{nav}/test")  # there is an exception below which a file may be
    assert not whole.prunes(nav)


def test_only_what_is_included(folder: Path) -> None:
    """`include` is relative to the path, too."""
    nav = str(folder.parent / "nav")
    (rule,) = found(folder, {"action": "sync", "path": "nav", "target": "/app", "include": ["src/*.py"]})
    assert [rule.takes(f"{nav}/{name}") for name in ("src/a.py", "src/deep/b.py", "package.xml")] == [
        True,
        False,
        False,
    ]


def test_a_folder_that_is_ignored_is_not_looked_at(folder: Path) -> None:
    """Such as one with 100,000 files."""
    nav = str(folder.parent / "nav")
    (rule,) = found(folder, {"action": "sync", "path": "nav", "target": "/app", "ignore": ["data/"]})
    assert [rule.prunes(f"{nav}/{name}") for name in ("data", ".git", "src")] == [True, True, False]


def test_a_file_that_is_mounted_comes_with_the_release(folder: Path) -> None:
    """Docker does not write into a read-only mount: the change is shipped."""
    mount = {"type": "bind", "source": str(folder.parent.joinpath(*["up"] * 24, "robot/nav.yaml")), "target": "/nav.yaml", "read_only": True}  # fmt: skip
    (rule,) = found(
        folder, {"action": "sync+restart", "path": "robot/nav.yaml", "target": "/nav.yaml"}, volumes=[mount]
    )
    assert rule.action == "rebuild"


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"action": "sync", "path": "nav/gone", "target": "/app"}, "nav/gone is not there; correct `path:`"),
        (
            {"action": "sync", "path": "nav", "target": "app"},
            "`target: app` is not a path in the container; write the whole path",
        ),
        ({"action": "jump", "path": "nav"}, "unknown action; use one of sync, sync+restart"),
    ],
)
def test_what_cannot_be_followed_is_refused(folder: Path, entry: dict[str, Any], text: str) -> None:
    """With the place in the file."""
    with pytest.raises(ComposeError) as caught:
        found(folder, entry)
    assert text in str(caught.value)
    assert "compose.yaml:4: services.node.develop.watch: " in str(caught.value)
