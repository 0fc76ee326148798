"""Which robots do an inventory file and the files it includes bring together, and which value wins?

Plain data in, plain data out: `fleet.config.inventory` says what may be written and gives the result its types. A robot's
values, later ones winning: the defaults of its own file, that file's groups, the groups of each including file, itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path, PurePosixPath
from typing import Any

from fleet.config import validation, yamlfile
from fleet.config.selection import did_you_mean, is_wildcard, matching
from fleet.errors import InventoryError

_PLAIN = re.compile(r"[\w-]+")

_MAPPINGS = {
    *("ros", "docker", "hardware", "card", "registry", "environment", "files", "stack", "pass_environment")
}
"""Keys without a value of their own: nothing there says nothing."""

Plain = dict[str, Any]
Complaint = tuple[yamlfile.Location, str]
Check = Callable[[yamlfile.Document], tuple[Plain, list[Complaint]]]


@dataclass(frozen=True, kw_only=True)
class Draft:
    """A robot in the making: where it is written, what its file and groups say, and what it says itself."""

    place: str
    shared: Plain
    own: Plain

    @property
    def values(self) -> Plain:
        """The merged values."""
        return merge(self.shared, self.own)


@dataclass(frozen=True, kw_only=True)
class Roster:
    """What one file and all it includes bring. Paths are absolute; robots and groups are in file order."""

    stacks: tuple[Plain, ...] = ()
    known_hosts: Path = Path()
    drafts: dict[str, Draft] = field(default_factory=dict)
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def peers(self, name: str) -> tuple[str, ...]:
        """The addresses of the other robots that ``ros.peers`` of a robot names; each once, in file order."""
        items = self.drafts[name].values.get("ros", {}).get("peers") or ()
        named = {robot for item in items for robot in self.groups.get(item) or matching(item, self.drafts)}
        others = (draft.values["address"] for robot, draft in self.drafts.items() if robot in named - {name})
        return tuple(dict.fromkeys(others))


def gather(path: Path, *, check: Check) -> tuple[Roster, tuple[str, ...]]:
    """What the inventory at ``path`` brings, and everything wrong with it, each as ``file:line: key: sentence``."""
    found, problems = _read(path, check=check, chain=())
    clashes = [problem for name, draft in found.drafts.items() for problem in _clashes(name, draft)]
    found = replace(found, groups={**found.groups, "all": tuple(found.drafts)})
    problems = (*problems, *clashes)
    # A `ros:` that is left out for another problem may have said the version.
    return found, problems or tuple(_wrong_versions(found.drafts))


def merge(under: Plain, over: Plain) -> Plain:
    """Both, ``over`` winning; the mappings inside (ros, docker, card, registry, environment, files) key by key. Hardware adds up.

    ``ros.hostname`` and ``ros.ip`` answer one question, so naming either replaces both. A ``ros.version`` replaces the
    keys of the other version.
    """
    merged = {**under, **over}
    for key in under.keys() & over.keys():
        if isinstance(under[key], dict) and isinstance(over[key], dict):
            replaced = _replaced(over[key]) if key == "ros" else set()
            kept = {name: value for name, value in under[key].items() if name not in replaced}
            merged[key] = _joined(kept, over[key]) if key == "hardware" else kept | over[key]
    return merged


def _joined(under: Plain, over: Plain) -> Plain:
    """The hardware of both: lists one after the other, each entry once; names of USB devices by name."""
    joined = {**under, **over}
    for key in under.keys() & over.keys():
        if isinstance(under[key], dict):
            joined[key] = under[key] | over[key]
        else:
            joined[key] = list(dict.fromkeys((*under[key], *over[key])))
    return joined


def _replaced(ros: Plain) -> set[str]:
    """The keys of an earlier `ros:` that do not count where this one is said."""
    names = {"hostname", "ip"} if {"hostname", "ip"} & ros.keys() else set()
    return names | set(validation.ROS_KEYS[3 - ros["version"]] if "version" in ros else ())


def key_path(location: yamlfile.Location) -> str:
    """A location as people write it: ``groups.lidar[1]``."""
    steps = (
        f".{step}" if isinstance(step, str) and _PLAIN.fullmatch(step) else f"[{step!r}]" for step in location
    )
    return "".join(steps).removeprefix(".")


def _clashes(name: str, draft: Draft) -> list[str]:
    files = draft.values.get("files", {})
    folders = {str(folder): inner for inner in files for folder in PurePosixPath(inner).parents}
    return [
        f"{draft.place}: robots.{name}.files: '{file}' cannot be a file and also the folder of '{folders[file]}'"
        for file in files
        if file in folders
    ]


def _wrong_versions(drafts: dict[str, Draft]) -> list[str]:
    """The problems of robots whose merged `ros:` has keys of the other version. Each is told once: many robots inherit it."""
    found: dict[str, list[str]] = {}
    for name, draft in drafts.items():
        if sentence := validation.other_version(draft.values.get("ros", {})):
            found.setdefault(sentence, []).append(name)
    return [
        f"{drafts[first].place}: robots.{first}.ros: {sentence}"
        + (f" (more robots with the same problem: {len(rest)})" if rest else "")
        for sentence, (first, *rest) in found.items()
    ]


def _read(path: Path, *, check: Check, chain: tuple[Path, ...]) -> tuple[Roster, tuple[str, ...]]:
    """What the file at ``path`` brings and what is wrong with it; ``chain`` are the files being read around it."""
    try:
        source = yamlfile.text(
            path,
            error=InventoryError,
            cure="go to the folder that has it, or write one here with `fab init`",
            once=True,
        )
        document, duplicates = yamlfile.parse(source, path=path, error=InventoryError)
    except InventoryError as bad:
        return Roster(), (str(bad),)
    file = _File(document, check=check, chain=(*chain, path.resolve()))
    roster = file.roster()
    problems = sorted((*duplicates, *file.problems))
    return roster, (*(f"{path}:{line}: {what}" for line, what in problems), *file.included_problems)


class _File:
    """One file on its way to a `Roster`; what is wrong with it collects in ``problems``."""

    def __init__(self, document: yamlfile.Document, *, check: Check, chain: tuple[Path, ...]) -> None:
        self.problems: list[yamlfile.Problem] = []
        self.included_problems: list[str] = []
        self._document = document
        self._folder = yamlfile.folder(document.path).resolve()
        self._check = check
        self._chain = chain
        self._drafts: dict[str, Draft] = {}
        self._groups: dict[str, tuple[str, ...]] = {}
        self._plain, complaints = check(document)
        for location, sentence in complaints:
            self._problem(location, sentence)

    def roster(self) -> Roster:
        """The robots and groups of this file and of those it includes."""
        for entry in self._plain.get("include") or ():
            self._include(entry)
        self._add_robots()
        for name, values in (self._plain.get("groups") or {}).items():
            self._add_group(name, values)
        return Roster(
            stacks=self._stacks(self._plain["stack"]),
            known_hosts=self._path(self._plain["known_hosts"]),
            drafts=self._drafts,
            groups=self._groups,
        )

    def _include(self, entry: Plain) -> None:
        places = (("include", position, "path") for position in count())
        location = next(place for place in places if self._document.text(place) == entry["path"])
        path = self._path(entry["path"])
        if not _is(path, Path.exists):
            if entry.get("required", True):
                self._problem(location, f"no such file: {path}; if it may be missing, say `required: false`")
            return
        if path.resolve() in self._chain:
            self._problem(location, "a file cannot include itself, not by way of another either")
            return
        shown = yamlfile.folder(self._document.path) / entry["path"]
        roster, problems = _read(shown, check=self._check, chain=self._chain)
        self.included_problems += problems
        for name, draft in roster.drafts.items():
            if name in self._drafts:
                self._problem(location, _twin(f"robots.{name} of {draft.place}", self._drafts[name]))
            self._drafts.setdefault(name, draft)
        for name, robots in roster.groups.items():
            self._groups[name] = (*self._groups.get(name, ()), *robots)

    def _add_robots(self) -> None:
        defaults = self._values(("defaults",), self._plain.get("defaults") or {})
        defaults["known_hosts"] = self._path(self._plain["known_hosts"])
        for name, values in (self._plain.get("robots") or {}).items():
            location = ("robots", name)
            if name in self._drafts:
                self._problem(location, _twin("this robot", self._drafts[name]))
            if name in self._groups:
                self._problem(location, "an included file has a group of this name; rename one of them")
            own = self._values(location, {"address": name, **values, "name": name})
            place = f"{self._document.path}:{self._document.line(location)}"
            self._drafts[name] = Draft(place=place, shared=defaults, own=own)

    def _add_group(self, name: str, values: Plain) -> None:
        location = ("groups", name)
        if name in self._drafts:
            self._problem(location, f"a robot has this name ({self._drafts[name].place}); rename one of them")
        patterns = values.pop("robots", None) or ()
        self._check_members(location, patterns)
        members = {robot for pattern in patterns for robot in matching(pattern, self._drafts)}
        members.update(self._groups.get(name, ()))
        self._groups[name] = tuple(robot for robot in self._drafts if robot in members)
        shared = self._values(location, values)
        for robot in self._groups[name]:
            draft = self._drafts[robot]
            self._drafts[robot] = replace(draft, shared=merge(draft.shared, shared))

    def _check_members(self, group: yamlfile.Location, names: Sequence[str]) -> None:
        known, groups = self._names()
        for name in names:
            if is_wildcard(name) or name in known or self.included_problems:
                continue
            cure = "a group holds robots, not groups" if name in groups else did_you_mean(name, known)
            self._problem(self._member(group, name), f"no such robot: {name}" + (f"; {cure}" if cure else ""))

    def _check_peers(self, location: yamlfile.Location, names: Sequence[str]) -> None:
        known, groups = self._names()
        for position, name in enumerate(names):
            if name in groups or matching(name, known) or self.included_problems:
                continue
            cure = did_you_mean(name, known | groups) or "name robots and groups of the inventory"
            no = "no robot matches" if is_wildcard(name) else "no such robot or group:"
            self._problem((*location, position), f"{no} {name}; {cure}")

    def _names(self) -> tuple[set[str], set[str]]:
        """The names of robots and groups that this file may use."""
        # A broken robot is reported once, where it is; a broken included file could hold any name.
        written = self._document.value.get("robots")
        robots = {*self._drafts, *(written if isinstance(written, dict) else ())}
        return robots, {*self._groups, *(self._plain.get("groups") or {}), "all"}

    def _member(self, group: yamlfile.Location, name: str) -> yamlfile.Location:
        for location in (group, (*group, "robots")):
            texts = self._document.texts(location)
            if name in texts:
                return (*location, texts.index(name))
        return group

    def _values(self, location: yamlfile.Location, values: Plain) -> Plain:
        """The values with paths absolute and environment values as text; an empty mapping says nothing."""
        said = {k: v for k, v in values.items() if v is not None or k not in _MAPPINGS}
        self._check_peers((*location, "ros", "peers"), said.get("ros", {}).get("peers") or ())
        if "stack" in said:
            said["stack"] = self._stacks(said["stack"])
        if said.get("identity_file") is not None:
            said["identity_file"] = self._path(said["identity_file"])
        if "environment" in said:
            said["environment"] = {
                name: value
                if isinstance(value, str)
                else self._document.text((*location, "environment", name))
                for name, value in said["environment"].items()
            }
        if "files" in said:
            said["files"] = {
                name: self._file((*location, "files", name), value) for name, value in said["files"].items()
            }
        if "registry" in said:
            said["registry"] = self._registry((*location, "registry"), said["registry"])
        script = said.get("docker", {}).get("script", "")
        if script and not script.startswith(("https://", "http://")):
            said["docker"] = {
                **said["docker"],
                "script": str(self._file((*location, "docker", "script"), script)),
            }
        return said

    def _registry(self, location: yamlfile.Location, registry: Plain) -> Plain:
        """The registry with absolute paths."""
        return {
            key: self._file((*location, key), value) if key in validation.REGISTRY_FILES and value else value
            for key, value in registry.items()
        }

    def _stacks(self, stacks: Sequence[Plain]) -> tuple[Plain, ...]:
        """The stacks with absolute paths."""
        return tuple(
            {
                **{key: value for key, value in stack.items() if value is not None},
                "files": tuple(self._path(written) for written in stack["files"]),
                "outside": tuple(self._path(written) for written in stack.get("outside") or ()),
            }
            for stack in stacks
        )

    def _file(self, location: yamlfile.Location, written: str) -> Path:
        path = self._path(written)
        if _is(path, Path.is_dir):
            self._problem(location, f"{path} is a folder; name its files one by one")
        elif not _is(path, Path.is_file):
            self._problem(location, f"no such file: {path}")
        return path

    def _path(self, written: str) -> Path:
        """The absolute path, from this file's folder; ``~`` is the person's home."""
        try:
            return self._folder / Path(written).expanduser()
        except RuntimeError:  # nobody of that name here: it stays as written, and is found missing
            return self._folder / written

    def _problem(self, location: yamlfile.Location, sentence: str) -> None:
        self.problems.append((self._document.line(location), f"{key_path(location)}: {sentence}"))


def _twin(robot: str, other: Draft) -> str:
    return f"{robot} is in {other.place} already; rename one of them"


def _is(path: Path, kind: Callable[[Path], bool]) -> bool:
    # A name that is too long, or a folder that may not be entered: then it is not there for us.
    try:
        return kind(path)
    except OSError:
        return False
