"""How do files get onto a card? Whole, and what was there is kept beside them."""

from __future__ import annotations

import contextlib
import errno
import os
from typing import TYPE_CHECKING, Literal

from fleet.card.first_boot import MARK
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
    kept = path.with_name(path.name + BEFORE)
    if path.exists() and not kept.exists() and MARK not in text(path):
        _replace(kept, path.read_bytes())
    _replace(path, content.encode())


def _replace(path: Path, data: bytes) -> None:
    """Write a file beside, and rename it when it is on the card: people pull cards out."""
    new = path.with_name(path.name + ".new")
    try:
        with new.open("wb") as out:
            out.write(data)
            out.flush()
            os.fsync(out.fileno())
        new.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)  # it may hold a part of a key
        raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Let a rename reach the card, also on a file system that cannot sync one folder (some in user space)."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as problem:
        if problem.errno not in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):
            raise
        os.sync()
    finally:
        os.close(handle)
