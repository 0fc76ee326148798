from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from fleet import onboard

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "fleet").rglob("*.py"))

LIBRARIES = {
    "cli.verb": {"fabric", "invoke"},
    "cli.console": {"rich"},
    "images.store": {"docker"},
    "config.inventory": {"pydantic", "pydantic_core"},
    **{
        name: {"pydantic"}
        for name in ("config.card", "config.hardware", "config.model", "config.registry", "config.ros")
    },
    "ssh.connect": {"paramiko"},
    "transfer.codec": {"backports", "compression"},
    "config.project_files": {"pathspec"},
    "rollout.saved_files": {"watchfiles"},
    "config.yamlfile": {"yaml"},
    "ssh.mdns": {"zeroconf"},
}
"""Each library has one module that imports it, and turns its exceptions into ours; pydantic has one more for each part
of an inventory that is a subject of its own."""

PURE = {
    *("errors", "platforms", "terminal", "units"),
    *(
        f"diagnosis.{name}"
        for name in ("explain", "installer_errors", "known_error", "known_errors", "packages")
    ),
    "diagnosis.registry_errors",
    *("config.image_reference", "config.selection", "config.stack", "config.validation"),
    *("images.build_log", "images.chunks", "images.image", "images.layer"),
    *("card.custom_toml", "card.first_boot", "card.userconf"),
    *("ros.cdr", "ros.environment", "ros.rosmsg", "ros.rtps", "ros.rtps_graph", "ros.silence"),
    *("ros.measure", "ros.message", "ros.quality", "ros.rtps_discovery", "ros.via_robot"),
    *("ros.silent_stack", "ros.unused_settings"),
    *("robot.hardware", "robot.raspberry_pi"),
    *("robot.claims", "robot.facts", "robot.history", "robot.image_store", "robot.paths", "robot.probe"),
    "plan",
    *(
        f"plan.{name}"
        for name in ("claims", "compose_steps", "containers", "delivery", "describe", "outcome", "prune")
    ),
    *(f"plan.{name}" for name in ("dev_steps", "hardware", "readiness", "ship", "step", "watch")),
    *("provision.hardware", "provision.jetson", "provision.registry_certs"),
    *("provision.apt", "provision.daemon_json", "provision.steps", "provision.sudo", "provision.whole_file"),
    *("transfer.codec", "transfer.delivery", "transfer.load_archive", "transfer.missing"),
    *("transfer.patch_format", "transfer.pull", "transfer.rebuild_command", "transfer.receive"),
    *("cli.json_output", "cli.overview", "cli.status"),
    *("config", "diagnosis", "images", "onboard", "provision", "card", "robot", "ros", "starter", "transfer"),
}
"""Values in, values out: their tests compare values, and nobody needs to imitate a robot for them."""

READS_FILES = {
    *("starter.packages", "starter.project"),
    *(
        "card.cloud_init",
        "config.card",
        "config.compose",
        "config.hardware",
        "config.ros",
        "config.inventory",
        "config.model",
        "config.merge",
        "config.project_files",
        "config.registry",
        "config.yamlfile",
    ),
    *("config.compose_wording", "config.docker_rules", "config.watch", "robot.release"),
}

EFFECTS = {
    "asyncio",
    "ctypes",
    "http",
    "multiprocessing",
    "os",
    "pathlib",
    "pty",
    "select",
    "shutil",
    "signal",
} | {
    *("socket", "socketserver", "subprocess", "tempfile", "threading", "time", "urllib.request", "xmlrpc"),
}

LONGEST_MODULE = 400
LONGEST_FUNCTION = 33
"""Lines from its first to its last, but for its docstring."""

EXCUSED: dict[str, str] = {}

UNTESTED: set[str] = set()
ABOUT_MORE = {
    "architecture": "all of it",
    "cli.json_contract": "what `--json` promises, whichever module prints it",
    "cli.verbs": "the verbs as a person types them",
    "ssh.logins": "connecting, with the ways to log in",
    "ssh.networks": "connecting, over links that fail",
}

SHELL_IN_PYTHON: set[str] = set()
"""Modules that still hold a shell script of more than three lines; `onboard/*.sh` is where scripts belong."""

SHELL = re.compile(
    r"^\s*(set -[eu]+\b|if \[|while .*; do|for .*; do|case .* in$|trap [\"'A-Z]|(done|fi|esac)\s*($|[;|&<>)]))",
    re.MULTILINE,
)

FORBIDDEN = {"base", "common", "core", "helper", "helpers", "manager", "misc", "util", "utils"}


def name_of(path: Path) -> str:
    """``cli.deploy`` for ``fleet/cli/deploy.py``, ``cli`` for that package's own file."""
    return ".".join(path.relative_to(ROOT / "fleet").with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}


def imported(tree: ast.AST, *, for_types: bool) -> set[str]:
    """Dotted names that are imported anywhere in it: at the top, in functions, and ``for_types`` only."""
    nodes = list(ast.iter_child_nodes(tree))
    if isinstance(tree, ast.If) and isinstance(tree.test, ast.Name) and tree.test.id == "TYPE_CHECKING":
        nodes = nodes if for_types else tree.orelse  # type: ignore[assignment]
    names = set().union(*(imported(node, for_types=for_types) for node in nodes))
    match tree:
        case ast.Import():
            names |= {alias.name for alias in tree.names}
        case ast.ImportFrom():
            assert tree.level == 0, "imports are absolute"
            names |= {f"{tree.module}.{alias.name}" for alias in tree.names}
        case _:
            pass
    return names


@cache
def ours(name: str) -> frozenset[str]:
    """The modules of fleet that a module needs when it runs."""
    everything = imported(MODULES[name], for_types=False)
    names = {other.removeprefix("fleet.") for other in everything if other.startswith("fleet.")}
    return frozenset(longest for other in names if (longest := _module(other)))


def _module(name: str) -> str:
    parts = name.split(".")
    prefixes = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((prefix for prefix in prefixes if prefix in MODULES), "")


@cache
def needed(name: str) -> frozenset[str]:
    """The modules that a module needs when it runs, and those that these need."""
    found: set[str] = set()
    todo = {name}
    while todo:
        found |= todo
        todo = set().union(*(ours(one) for one in todo)) - found
    return frozenset(found - {name})


@pytest.mark.parametrize("name", MODULES)
def test_each_library_is_imported_by_one_module(name: str) -> None:
    """Also inside functions and for types only: who replaces a library edits one file."""
    roots = {other.partition(".")[0] for other in imported(MODULES[name], for_types=True)}
    assert roots - sys.stdlib_module_names - {"fleet"} <= LIBRARIES.get(name, set())


def test_each_library_of_the_table_is_used() -> None:
    """A table that promises too much would let a second import pass."""
    for name, libraries in LIBRARIES.items():
        roots = {other.partition(".")[0] for other in imported(MODULES[name], for_types=True)}
        assert libraries <= roots


@pytest.mark.parametrize("name", sorted(PURE))
def test_planning_is_pure(name: str) -> None:
    """It needs only what is pure too, and nothing of Python's that touches the world."""
    assert needed(name) <= PURE
    own = imported(MODULES[name], for_types=False)
    assert not {effect for effect in EFFECTS if any(f"{other}.".startswith(f"{effect}.") for other in own)}


@pytest.mark.parametrize("name", sorted(READS_FILES))
def test_reading_is_no_more_than_that(name: str) -> None:
    """Inventory and stack come from files, and go nowhere."""
    assert needed(name) <= PURE | READS_FILES


def test_no_module_needs_itself() -> None:
    """No circles: each can be read, and tested, before those that use it."""
    for name in MODULES:
        assert not {other for other in needed(name) if name in needed(other)}


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_modules_and_functions_are_short(path: Path) -> None:
    """A module is read in one sitting, a function at one glance."""
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST_MODULE
    for node in ast.walk(MODULES[name_of(path)]):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            where = f"{name_of(path)}.{node.name}"
            first = node.body[0]
            words = ast.get_docstring(node, clean=False)
            said = (first.end_lineno or 0) - first.lineno + 1 if words is not None else 0
            length = (node.end_lineno or 0) - node.lineno + 1 - said
            assert length <= LONGEST_FUNCTION or where in EXCUSED, where


def test_excuses_are_still_needed() -> None:
    """An excuse for a function that is short, or gone, would excuse the next one."""
    for where in EXCUSED:
        module, _, function = where.rpartition(".")
        (node,) = (
            node
            for node in ast.walk(MODULES[module])
            if isinstance(node, ast.FunctionDef) and node.name == function
        )
        assert (node.end_lineno or 0) - node.lineno >= LONGEST_FUNCTION


@pytest.mark.parametrize("name", [name for name in MODULES if name != "__init__"])
def test_names_shadow_nothing_and_mean_something(name: str) -> None:
    """A module named like a library or like one of Python's own is found in its place by somebody, some day."""
    for part in name.split("."):
        assert part not in sys.stdlib_module_names
        assert part not in {library for libraries in LIBRARIES.values() for library in libraries}
        assert part not in FORBIDDEN


def test_every_module_has_its_tests_and_no_test_is_about_nothing() -> None:
    """`fleet/plan/ship.py` is tested by `tests/unit/plan/test_ship.py`, and so is each shell script."""
    modules = {name for name in MODULES if not (ROOT / "fleet" / name.replace(".", "/")).is_dir()}
    scripts = {f"onboard.{path.stem}" for path in (ROOT / "fleet" / "onboard").glob("*.sh")}
    unit = ROOT / "tests" / "unit"
    tests = {
        ".".join(path.with_name(path.stem.removeprefix("test_")).relative_to(unit).parts)
        for path in unit.rglob("test_*.py")
    }
    assert (modules | scripts) - {"__init__", "errors"} - tests == UNTESTED
    beside = {
        test
        for test in tests - modules - scripts
        if test.partition(".")[0] not in ("bench", "docker", "docs", "support", "talker")
    }
    assert beside == set(ABOUT_MORE)


def test_each_module_says_what_it_answers() -> None:
    """A question, or a sentence, in the first line of its docstring."""
    for name, tree in MODULES.items():
        first = (ast.get_docstring(tree) or "").partition("\n")[0]
        assert first.endswith(("?", ".")), name


def test_docker_is_a_folder_and_no_package() -> None:
    """With an ``__init__.py`` it would be found in place of the SDK."""
    assert not list((ROOT / "docker").rglob("__init__.py"))


def test_an_import_that_runs_up_is_refused(tmp_path: Path) -> None:
    """`lint-imports`, which holds the layers of the rooms, fails on it and names both modules."""
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copytree(ROOT / "fleet", tmp_path / "fleet", ignore=shutil.ignore_patterns("__pycache__"))

    def lint() -> subprocess.CompletedProcess[str]:
        command = (sys.executable, "-c", "from importlinter.cli import lint_imports_command as run; run()")
        return subprocess.run(
            (*command, "--no-cache"),
            cwd=tmp_path,
            env={"PYTHONPATH": str(tmp_path), "COLUMNS": "200"},
            capture_output=True,
            text=True,
            check=False,
        )

    assert lint().returncode == 0
    with (tmp_path / "fleet/config/selection.py").open("a", encoding="utf-8") as lower:
        lower.write("\nimport fleet.rollout.pool\n")
    done = lint()
    assert done.returncode == 1
    assert "fleet.config.selection -> fleet.rollout.pool" in done.stdout


def shell_scripts(tree: ast.AST) -> list[int]:
    """The lines on which a string begins that is a shell script of more than three lines."""
    strings = [
        node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    strings += [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]  # type: ignore[misc]
    return [node.lineno for node in strings if _is_script(_text(node))]


def _text(node: ast.expr) -> str:
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return "".join(str(part.value) if isinstance(part, ast.Constant) else "x" for part in parts)


def _is_script(text: str) -> bool:
    return len(text.strip().splitlines()) > 3 and SHELL.search(text) is not None


@pytest.mark.parametrize("name", MODULES)
def test_a_shell_script_is_a_file(name: str) -> None:
    """What runs on a robot is checked by shellcheck, which reads no Python strings."""
    assert bool(shell_scripts(MODULES[name])) == (name in SHELL_IN_PYTHON)


def test_a_shell_script_in_a_string_is_found() -> None:
    """Also with values put into it; three lines are no script, and prose is none."""
    script = "x = {}'''\nset -e\nfor name in *; do\n  echo $name {}\ndone\n'''"
    assert shell_scripts(ast.parse(script.format("", "")))
    assert shell_scripts(ast.parse(script.format("f", "{y}")))
    assert not shell_scripts(ast.parse("x = 'set -e\\nif [ 1 ]; then echo\\nfi'"))
    assert not shell_scripts(ast.parse("'''If it is\ndone,\nit ends\nat last.'''"))


def test_what_travels_is_the_same_script() -> None:
    """Without comments and indentation it means the same to a shell: each of these can be parsed, and says what it does."""
    for path in sorted((ROOT / "fleet/onboard").glob("*.sh")):
        text = onboard.text(path.name)
        assert subprocess.run(("sh", "-n", "-c", text), check=False).returncode == 0, path
        assert text.splitlines()[:2] == path.read_text().splitlines()[:2]
        assert text.splitlines()[2] == onboard.ENGLISH, path
        assert len(text) < len(path.read_text()) + len(onboard.ENGLISH)
    for name in ("boot.sh", "install.sh"):  # which do not travel as text
        assert onboard.ENGLISH in onboard.source(name)
