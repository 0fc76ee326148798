"""How do files get onto a card? Whole, and what was there is kept beside them."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING, Literal

from fleet.card import cloud_init
from fleet.errors import DesktopError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

State = Literal["written", "unchanged"]

BEFORE = ".before-fleet"
"""The end of the name of a file that was there before."""


def planned(files: Mapping[str, str], *, folder: Path) -> dict[str, State]:
    """Return which files would be written, and which are there with the same content."""
    return {
        name: "unchanged" if text(folder / name) == content and (folder / name).exists() else "written"
        for name, content in files.items()
    }


def write(files: Mapping[str, str], *, folder: Path) -> dict[str, State]:
    """Write the files that are not there with the same content, and return which were. They are on the card when it ends.

    Raises:
        DesktopError: the card is full, read-only, or was pulled out.

    """
    states = planned(files, folder=folder)
    for name, state in states.items():
        if state == "written":
            try:
                _one(files[name], folder / name)
            except OSError as problem:
                cure = "see whether the card is full or locked; then run `fab card` again"
                raise DesktopError(
                    f"{folder / name} cannot be written: {problem.strerror}", cure=cure
                ) from None
    return states


def text(path: Path) -> str:
    """Return the text of a file on a card, "" without one.

    Raises:
        DesktopError: it cannot be read.

    """
    try:
        return path.read_bytes().decode(errors="replace")
    except FileNotFoundError:
        return ""
    except OSError as problem:
        cure = "write the card again; if that does not help, use another card"
        raise DesktopError(f"{path} cannot be read: {problem.strerror}", cure=cure) from None


def _one(content: str, path: Path) -> None:
    kept, new = path.with_name(path.name + BEFORE), path.with_name(path.name + ".new")
    if path.exists() and not kept.exists() and cloud_init.MARK not in text(path):
        _flushed(kept, path.read_bytes())
    try:
        _flushed(new, content.encode())
        new.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)  # it may hold a part of a key
        raise
    handle = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _flushed(path: Path, data: bytes) -> None:
    """People pull cards out."""
    with path.open("wb") as out:
        out.write(data)
        out.flush()
        os.fsync(out.fileno())
