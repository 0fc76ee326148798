"""Which command makes a new layer of an old one on a robot? Its program is `fleet.onboard.rebuild_layer`."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

from fleet.images.layer import chain_id, common_prefix

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from fleet.images.layer import Blob
    from fleet.plan.step import Upload

UNUSABLE = 65
"""Exit code: the old layer or the patch is damaged, or they are not of each other (sysexits.h, EX_DATAERR)."""

MISSING = 69
"""Exit code: there is no such old layer, no right to read it, or no zstd (EX_UNAVAILABLE)."""

BROKEN = 74
"""Exit code: reading or writing failed (EX_IOERR)."""

DATA_ROOT = "/var/lib/docker"

_CONTENT = "io.containerd.content.v1.content/blobs/sha256"


@dataclass(frozen=True, kw_only=True)
class Source:
    """A layer that a robot has, and of which another one may be made; ``where`` are the arguments that name it there."""

    diff_id: str
    where: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class RebuiltLayer:
    """A layer (``diff_id``, ``size`` bytes of tar) that a robot makes of one it has; without a patch it is the same one."""

    diff_id: str
    size: int
    source: Source
    patch: Upload | None


def sources(
    images: Iterable[tuple[str, ...]],
    lacking: Iterable[str],
    *,
    chains: Iterable[tuple[str, ...]],
    manifests: Iterable[Sequence[Blob]],
    containerd: bool,
    root: str = DATA_ROOT,
) -> dict[str, Source]:
    """For each layer that is lacking the one it may be made of: itself in another place, or else its predecessor.

    That is the layer in the same place of the image there that has most layers below it in common.
    """
    there = (
        [tuple((blob.diff_id, from_blob(blob.digest, root=root)) for blob in blobs) for blobs in manifests]
        if containerd
        else [_places(chain, root) for chain in chains]
    )
    same = {diff_id: where for places in there for diff_id, where in places}
    found: dict[str, Source] = {}
    for image in images:
        nearest = sorted(there, key=lambda places: -common_prefix(image, [diff_id for diff_id, _ in places]))
        for at, wanted in enumerate(image):
            if wanted in same:
                found[wanted] = Source(diff_id=wanted, where=same[wanted])
            elif place := next((places[at] for places in nearest if len(places) > at), None):
                found.setdefault(wanted, Source(diff_id=place[0], where=place[1]))
    return {wanted: found[wanted] for wanted in lacking if wanted in found}


def _places(chain: tuple[str, ...], root: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple(
        (diff_id, from_chain(chain_id(chain[: at + 1]), root=root)) for at, diff_id in enumerate(chain)
    )


def program() -> bytes:
    """The program, to be sent to a robot."""
    return (resources.files("fleet.onboard") / "rebuild_layer.py").read_bytes()


def program_digest() -> str:
    """Its SHA-256 in hex: what it is called in a robot's spool."""
    return hashlib.sha256(program()).hexdigest()


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
