"""Which files of the desktop does a stack want to follow, and what is done when they change? Compose's ``develop.watch``.

The words are Compose's own, as its canonical model has them. As with `docker compose watch`, the ``.dockerignore`` of the
build's context counts too, and what editors leave for a moment is ignored.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any, Literal

from fleet.config.compose import where
from fleet.config.stack import literal
from fleet.errors import ComposeError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from fleet.config.compose import Project
    from fleet.config.stack import Stack

Action = Literal["sync", "sync+restart", "sync+exec", "restart", "rebuild"]

_ACTIONS: dict[str, Action] = {
    "sync": "sync",
    "sync+restart": "sync+restart",
    "sync+exec": "sync+exec",
    "restart": "restart",
    "rebuild": "rebuild",
}

_MOMENTARY = (
    *("**/.git", "**/.svn", "**/.hg", "**/__pycache__", "**/.idea", "**/.vscode"),
    *(
        "**/*~",
        "**/.*.sw?",
        "**/4913",
        "**/.#*",
        "**/#*#",
        "**/*___jb_tmp___",
        "**/*___jb_old___",
        "**/.DS_Store",
    ),
)
"""What version control and editors (Vim, Emacs, JetBrains) have beside the files: Compose's list, and Python's cache."""


class Patterns:
    """Patterns in the syntax of ``.dockerignore``, for paths relative to one folder. The last one that matches decides."""

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = tuple(line.strip() for line in lines if line.strip() and not line.startswith("#"))
        self.exceptions = any(line.startswith("!") for line in self.lines)
        self._rules = [(not line.startswith("!"), _compiled(line)) for line in self.lines]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Patterns) and self.lines == other.lines

    def __hash__(self) -> int:
        return hash(self.lines)

    def match(self, path: str) -> bool:
        """Whether a path, or a folder above it, matches."""
        parts = path.split("/")
        above = ["/".join(parts[:count]) for count in range(1, len(parts) + 1)]
        matched = False
        for takes, pattern in self._rules:
            if takes != matched and any(pattern.fullmatch(one) for one in above):
                matched = takes
        return matched


def _compiled(line: str) -> re.Pattern[str]:
    """Raises `ComposeError` if a range in it is none, such as ``[b-a]``."""
    try:
        return re.compile(_regex(line.lstrip("!")))
    except re.error as problem:
        raise ComposeError(
            f"the pattern {line} of develop.watch or .dockerignore is wrong: {problem}", cure="correct it"
        ) from None


def _regex(pattern: str) -> str:
    """A pattern of ``.dockerignore`` (Go's ``filepath.Match``, and ``**`` for any folders) as a regular expression."""
    text = str(PurePosixPath(pattern.strip())).strip("/")
    text = "" if text == "." else text
    pieces = re.findall(r"\*\*/|\*\*|\*|\?|\[\^?[^\]]+\]|\\.|.", text)
    words = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
    return "".join(
        words.get(one) or (one if one[0] == "[" and len(one) > 2 else re.escape(one[-1])) for one in pieces
    )


@dataclass(frozen=True, kw_only=True)
class Hook:
    """A command in the container after a sync (``exec:``). ``user`` and ``folder`` are those of the container if empty."""

    command: tuple[str, ...]
    user: str = ""
    folder: str = ""
    privileged: bool = False
    environment: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One entry of ``develop.watch``.

    ``path`` is a file or a folder of this computer, ``target`` where it is in the container. ``initial``: what is there
    already is synced at the start. ``ignored`` and ``only`` are relative to ``path``; ``build_ignored`` to ``context``,
    the folder of the build. ``mounted`` are the places in the container that something else is mounted on: what is there
    belongs to the robot or to the release, and is not synced.
    """

    service: str
    action: Action
    path: str
    target: str = ""
    initial: bool = False
    ignored: Patterns = field(default_factory=lambda: Patterns(()))
    only: Patterns = field(default_factory=lambda: Patterns(()))
    context: str = ""
    build_ignored: Patterns = field(default_factory=lambda: Patterns(()))
    mounted: tuple[str, ...] = ()
    hook: Hook | None = None

    @property
    def syncs(self) -> bool:
        """Whether files go into the container."""
        return self.action.startswith("sync")

    def takes(self, path: str) -> bool:
        """Whether the rule is about a file of this computer. A file that the rule names itself is never ignored."""
        if path == self.path:
            return True
        if not path.startswith(f"{self.path}/") or self._leaves_out(path):
            return False
        if self.syncs and _below(self.place(path), self.mounted):
            return False
        return not self.only.lines or self.only.match(path[len(self.path) + 1 :])

    def prunes(self, folder: str) -> bool:
        """Whether nothing below a folder can be taken, so that nobody has to look."""
        exceptions = self.ignored.exceptions or self.build_ignored.exceptions
        return folder.startswith(f"{self.path}/") and not exceptions and self._leaves_out(folder)

    def place(self, path: str) -> str:
        """Where a file of this computer is in the container."""
        return str(PurePosixPath(self.target) / path[len(self.path) :].lstrip("/"))

    def _leaves_out(self, path: str) -> bool:
        below = path[len(self.path) + 1 :]
        if _ALWAYS.match(below) or self.ignored.match(below):
            return True
        inside = self.context and path.startswith(f"{self.context}/")
        return bool(inside) and self.build_ignored.match(path[len(self.context) + 1 :])


_ALWAYS = Patterns(_MOMENTARY)


def rules(stack: Stack, project: Project) -> tuple[Rule, ...]:
    """The rules of all services of a stack, in the order of the file.

    Raises:
        ComposeError: an entry cannot be followed: its path is not there, or its target is not a path in the container.

    """
    return tuple(
        _rule(name, number, entry, service, project=project, stack=stack)
        for name, service in (stack.model.get("services") or {}).items()
        for number, entry in enumerate((service.get("develop") or {}).get("watch") or ())
    )


def _rule(
    name: str,
    number: int,
    entry: Mapping[str, Any],
    service: Mapping[str, Any],
    *,
    project: Project,
    stack: Stack,
) -> Rule:
    here = project.here(literal(str(entry["path"]))).resolve()
    action, target = _ACTIONS.get(str(entry.get("action"))), literal(str(entry.get("target") or ""))
    if action is None or not here.exists() or (action.startswith("sync") and not target.startswith("/")):
        raise _refusal(name, number, here, action, target, project=project)
    if _is_mounted(here, name, project=project, stack=stack):
        action = "rebuild"  # a file of the release itself: only a ship brings it
    mounted = tuple(str(volume["target"]) for volume in service.get("volumes") or ())
    if action.startswith("sync") and _below(target, mounted):
        raise _onto_mount(_place(name, number, project), target)
    context, ignored = _build_ignored(service, project)
    return Rule(
        service=name,
        action=action,
        path=str(here),
        target=target,
        initial=bool(entry.get("initial_sync")),
        ignored=Patterns(map(literal, entry.get("ignore") or ())),
        only=Patterns(map(literal, entry.get("include") or ())),
        context=context,
        build_ignored=ignored,
        mounted=mounted,
        hook=_hook(entry.get("exec") or {}) if action == "sync+exec" else None,
    )


def _refusal(
    name: str, number: int, here: Path, action: Action | None, target: str, *, project: Project
) -> ComposeError:
    """Why an entry cannot be followed, with its place in the file."""
    place = _place(name, number, project)
    if action is None:
        return ComposeError(f"{place}: unknown action", cure=f"use one of {', '.join(_ACTIONS)}")
    if not here.exists():
        return ComposeError(f"{place}: {here} is not there", cure="correct `path:`, or make the folder")
    what = f"`target: {target}` is not a path in the container"
    return ComposeError(f"{place}: {what}", cure="write the whole path, such as /opt/talker")


def _onto_mount(place: str, target: str) -> ComposeError:
    return ComposeError(
        f"{place}: `target: {target}` is on a volume or a mount, and what is there belongs to the robot",
        cure="sync to another folder, or mount the folder of the project read-only: then changes are shipped",
    )


def _place(service: str, number: int, project: Project) -> str:
    """Where an entry is, for a message."""
    return f"{where(project, ('services', service, 'develop', 'watch', number))}: services.{service}.develop.watch"


def _below(path: str, folders: Iterable[str]) -> bool:
    return any(PurePosixPath(path).is_relative_to(folder) for folder in folders)


def _is_mounted(here: Path, service: str, *, project: Project, stack: Stack) -> bool:
    """Whether a container has the path mounted from the project's folder."""
    mounts = [(project.real / mount.path).resolve() for mount in stack.mounts if mount.service == service]
    return any(here.is_relative_to(mount) for mount in mounts)


def _build_ignored(service: Mapping[str, Any], project: Project) -> tuple[str, Patterns]:
    """The build's folder and its ``.dockerignore``, as BuildKit finds it; a context that is not here has neither."""
    build = service.get("build") or {}
    context = project.here(literal(str(build.get("context") or ""))).resolve()
    if not build or not context.is_dir():
        return "", Patterns(())
    dockerfile = context / str(build.get("dockerfile") or "Dockerfile")
    for file in (dockerfile.with_name(f"{dockerfile.name}.dockerignore"), context / ".dockerignore"):
        if file.is_file():
            return str(context), Patterns(file.read_text(encoding="utf-8", errors="replace").splitlines())
    return str(context), Patterns(())


def _hook(value: Mapping[str, Any]) -> Hook:
    return Hook(
        command=tuple(literal(str(word)) for word in value.get("command") or ()),
        user=str(value.get("user") or ""),
        folder=literal(str(value.get("working_dir") or "")),
        privileged=bool(value.get("privileged")),
        environment=tuple(_pairs(value.get("environment") or {})),
    )


def _pairs(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if value is not None:
            yield name, literal(str(value))
