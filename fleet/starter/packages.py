"""Which ROS packages are in a folder, and how are their programs started?

A package is a folder with a ``package.xml``, of ROS 1 or ROS 2, in Python or C++. Nothing of it is run: its programs are
those that its files name.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from fleet.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from xml.etree.ElementTree import Element

DEEPEST = 6
"""Folders below the first one in which packages are looked for: workspaces have fewer."""

_IGNORED = frozenset({"COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE"})
_MADE = frozenset({"build", "devel", "install", "log", "node_modules", "venv", "__pycache__"})
_TESTS = frozenset({"test", "tests"})
_LAUNCH_1 = re.compile(r"\.launch$")
_LAUNCH_2 = re.compile(r"[._]launch\.(py|xml|yaml)$")
_SCRIPTS = re.compile(r"console_scripts['\"]?\s*[:=]\s*\[?(.*?)(?:\]|^\[|\Z)", re.DOTALL | re.MULTILINE)
_SCRIPT = re.compile(r"([A-Za-z0-9_.-]+)\s*=\s*[A-Za-z_][\w.]*:\w+")
_EXECUTABLE = re.compile(r"^\s*add_executable\s*\(\s*([\w.-]+)", re.MULTILINE)
_COMPONENT = re.compile(r"\bEXECUTABLE\s+([\w.-]+)")


@dataclass(frozen=True, kw_only=True)
class Package:
    """One ROS package. ``folder`` is relative to the folder that was searched, "." for that itself.

    ``ros`` holds the generations that it can be built for, 1 and 2. ``launches`` and ``programs`` are names, as
    ``ros2 launch`` and ``ros2 run`` take them.
    """

    name: str
    folder: str
    ros: frozenset[int]
    launches: tuple[str, ...] = ()
    programs: tuple[str, ...] = ()


def find(folder: Path) -> tuple[Package, ...]:
    """Return the packages in a folder and below it, in the order of their folders.

    Folders that colcon or catkin ignore or make, and hidden ones, are left out.

    Raises:
        UsageError: a ``package.xml`` cannot be read.

    """
    return tuple(_read(manifest, folder) for manifest in sorted(_manifests(folder)))


def _manifests(top: Path) -> Iterator[Path]:
    for place, folders, files in os.walk(top):
        folder = Path(place)
        depth = len(folder.relative_to(top).parts)
        if _IGNORED & {*files}:
            folders.clear()
        elif "package.xml" in files:
            folders.clear()  # packages hold no packages
            yield folder / "package.xml"
        elif depth == DEEPEST:
            folders.clear()
        else:
            folders[:] = [name for name in folders if name not in _MADE and not name.startswith(".")]


def _read(manifest: Path, top: Path) -> Package:
    cure = "correct it, or put an empty file COLCON_IGNORE beside it"
    try:
        # A file of the person's own workspace, which ROS's tools read with the same parser.
        root = ET.fromstring(manifest.read_bytes())  # noqa: S314
    except (OSError, ET.ParseError, ValueError) as problem:
        raise UsageError(f"{manifest} cannot be read: {problem}", cure=cure) from None
    name = (root.findtext("name") or "").strip()
    if root.tag != "package" or not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise UsageError(f"{manifest} does not name a package", cure=cure)
    folder, ros = manifest.parent, _generations(root)
    files = tuple(_files(folder))
    return Package(
        name=name,
        folder=folder.relative_to(top).as_posix(),
        ros=ros,
        launches=_launches(files, ros),
        programs=_programs(files, folder, ros),
    )


def _generations(root: Element) -> frozenset[int]:
    """ROS 1, ROS 2 or both, by the tools that the package is built with."""
    tools = [
        element.text or ""
        for tag in ("buildtool_depend", "export/build_type")
        for element in root.iterfind(tag)
    ]
    found = {1 if "catkin" in tool else 2 for tool in tools if "catkin" in tool or "ament" in tool}
    return frozenset(found or {1, 2})


def _files(package: Path) -> Iterator[Path]:
    for place, folders, files in os.walk(package):
        folders[:] = sorted(
            name for name in folders if name not in _MADE | _TESTS and not name.startswith(".")
        )
        yield from (Path(place) / name for name in sorted(files))


def _launches(files: tuple[Path, ...], ros: frozenset[int]) -> tuple[str, ...]:
    patterns = [pattern for number, pattern in ((1, _LAUNCH_1), (2, _LAUNCH_2)) if number in ros]
    return tuple(path.name for path in files if any(pattern.search(path.name) for pattern in patterns))


def _programs(files: tuple[Path, ...], package: Path, ros: frozenset[int]) -> tuple[str, ...]:
    found: list[str] = []
    for path in files:
        if path.parent == package and path.name in ("setup.py", "setup.cfg"):
            found += [name for part in _SCRIPTS.findall(_text(path)) for name in _SCRIPT.findall(part)]
        elif path.parent == package and path.name == "CMakeLists.txt":
            text = re.sub(r"#.*", "", _text(path))
            found += [*_EXECUTABLE.findall(text), *_COMPONENT.findall(text)]
        elif 1 in ros and path.parent.name in ("nodes", "scripts") and os.access(path, os.X_OK):
            found.append(path.name)
    return tuple(dict.fromkeys(found))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
