"""Which command makes a new layer of an old one on a robot? Its program is `fleet.transfer.rebuild`."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

UNUSABLE = 65
"""Exit code: the old layer or the patch is damaged, or they are not of each other (sysexits.h, EX_DATAERR)."""

MISSING = 69
"""Exit code: there is no such old layer, no right to read it, or no zstd (EX_UNAVAILABLE)."""

BROKEN = 74
"""Exit code: reading or writing failed (EX_IOERR)."""

DATA_ROOT = "/var/lib/docker"

_CONTENT = "io.containerd.content.v1.content/blobs/sha256"


def program() -> str:
    """The text of the program, to be sent to a robot."""
    return (resources.files("fleet.transfer") / "rebuild.py").read_text(encoding="utf-8")


def from_chain(chain_id: str, *, root: str = DATA_ROOT) -> tuple[str, ...]:
    """Arguments that name a layer of a classic overlay2 store, which root may read."""
    return ("--root", root, "--chain", chain_id)


def from_blob(digest: str, *, root: str = DATA_ROOT) -> tuple[str, ...]:
    """Arguments that name a blob of a containerd store, which root may read.

    dockerd's own containerd keeps it below the data root, the system's below ``/var/lib/containerd``.
    """
    places = (f"{root}/containerd/daemon", "/var/lib/containerd")
    paths = (f"{place}/{_CONTENT}/{digest.removeprefix('sha256:')}" for place in places)
    return from_files(*paths)


def from_files(*paths: str) -> tuple[str, ...]:
    """Arguments that name a layer's tar, plain or packed: the first of these files that exists."""
    return tuple(part for path in paths for part in ("--file", path))


def argv(
    program_path: str,
    old: Sequence[str],
    *,
    wanted: str,
    patch: str = "",
    scratch: str = ".",
    check: bool = False,
) -> tuple[str, ...]:
    """The command that writes the layer ``wanted`` (its diff ID), or with ``check`` only proves that it could.

    ``old`` are the arguments of one of the functions above; without a ``patch`` the old layer is the wanted one.
    ``scratch`` is a directory for small files, or a large one where the old layer is packed.
    """
    with_patch = ("--patch", patch) if patch else ()
    checking = ("--check",) if check else ()
    return ("python3", "-IS", program_path, *old, *with_patch, "--scratch", scratch, *checking, wanted)
