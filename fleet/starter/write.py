"""How do the files of a new project get into a folder? Whole, and never over a file that is there."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fleet.errors import DesktopError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

State = Literal["written", "kept"]


@dataclass(frozen=True, kw_only=True)
class File:
    """The content of a file, and whether it is a program."""

    data: bytes
    executable: bool = False


def planned(files: Mapping[str, File], *, folder: Path) -> dict[str, State]:
    """Return which files would be written, and which are there and would be kept. A broken link counts as a file."""
    return {name: "kept" if os.path.lexists(folder / name) else "written" for name in files}


def write(files: Mapping[str, File], *, folder: Path) -> dict[str, State]:
    """Write the files that are not there, and return which were.

    Raises:
        DesktopError: the folder cannot be written to.

    """
    return {name: _one(file, folder / name) for name, file in files.items()}


def _one(file: File, path: Path) -> State:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise _refusal(path.parent, problem) from None
    try:
        # Only a new file is opened: another program may write one at this moment.
        out = path.open("xb")
    except FileExistsError:
        return "kept"
    except OSError as problem:
        raise _refusal(path, problem) from None
    try:
        with out:
            out.write(file.data)
        if file.executable:
            path.chmod(path.stat().st_mode | 0o111)
    except OSError as problem:
        path.unlink(missing_ok=True)  # a part of a file would be kept by the next run
        raise _refusal(path, problem) from None
    return "written"


def _refusal(path: Path, problem: OSError) -> DesktopError:
    cure = "see who may write to this folder, and whether its disk is full"
    return DesktopError(f"{path} cannot be written: {problem.strerror}", cure=cure)
