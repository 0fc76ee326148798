"""The command that rebuilds a layer on a robot from one that the robot has, with `fleet.onboard.rebuild_layer`."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.images.layer import chain_id, common_prefix

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from fleet.images.layer import Blob
    from fleet.plan.step import Upload

DATA_ROOT = "/var/lib/docker"

_CONTENT = "io.containerd.content.v1.content/blobs/sha256"


@dataclass(frozen=True, kw_only=True)
class Source:
    """A layer on the robot from which another one is made; ``where`` has the arguments that name it."""

    diff_id: str
    where: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class RebuiltLayer:
    """A layer (``diff_id``, ``size`` bytes of tar) that the robot makes from ``source``; without a patch it is a copy."""

    diff_id: str
    size: int
    source: Source
    patch: Upload | None


def sources(
    images: Iterable[tuple[str, ...]],
    missing: Iterable[str],
    *,
    chains: Iterable[tuple[str, ...]],
    manifests: Iterable[Sequence[Blob]],
    containerd: bool,
    root: str = DATA_ROOT,
) -> dict[str, Source]:
    """Find the layer from which each missing layer may be made: the same layer in another place, or its predecessor.

    The predecessor is the layer at the same height of the robot's image that shares the most lower layers.
    """
    there = (
        [tuple((blob.diff_id, from_blob(blob.digest, root=root)) for blob in blobs) for blobs in manifests]
        if containerd
        else [_places(chain, root) for chain in chains]
    )
    same = {diff_id: where for places in there for diff_id, where in places}
    chosen: dict[str, Source] = {}
    for image in images:
        nearest = sorted(there, key=lambda places: -common_prefix(image, [diff_id for diff_id, _ in places]))
        for at, wanted in enumerate(image):
            if wanted in same:
                chosen[wanted] = Source(diff_id=wanted, where=same[wanted])
            elif place := next((places[at] for places in nearest if len(places) > at), None):
                chosen.setdefault(wanted, Source(diff_id=place[0], where=place[1]))
    return {wanted: chosen[wanted] for wanted in missing if wanted in chosen}


def _places(chain: tuple[str, ...], root: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple(
        (diff_id, from_chain(chain_id(chain[: at + 1]), root=root)) for at, diff_id in enumerate(chain)
    )


def program() -> bytes:
    """The program that is sent to the robot."""
    return onboard.source("rebuild_layer.py").encode()


def program_digest() -> str:
    """The SHA-256 of the program in hex: its file name in the robot's spool."""
    return hashlib.sha256(program()).hexdigest()


def from_chain(chain_id: str, *, root: str = DATA_ROOT) -> tuple[str, ...]:
    """Arguments that name a layer of a classic overlay2 store, which only root may read."""
    return ("--root", root, "--chain", chain_id)


def from_blob(digest: str, *, root: str = DATA_ROOT) -> tuple[str, ...]:
    """Arguments that name a blob of a containerd store, which only root may read.

    dockerd's own containerd keeps it below the data root, the system's below ``/var/lib/containerd``.
    """
    places = (f"{root}/containerd/daemon", "/var/lib/containerd")
    paths = (f"{place}/{_CONTENT}/{digest.removeprefix('sha256:')}" for place in places)
    return from_files(*paths)


def from_files(*paths: str) -> tuple[str, ...]:
    """Arguments that name a layer's tar, plain or packed: the first of the files that exists."""
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
    """The command that writes the layer ``wanted`` (its diff ID), or with ``check`` only proves that it can.

    ``old`` comes from one of the functions above; without a ``patch`` the old layer itself is the wanted one. ``scratch``
    is a directory for small files, and for a large one if the old layer is packed.
    """
    with_patch = ("--patch", patch) if patch else ()
    checking = ("--check",) if check else ()
    return ("python3", "-IS", program_path, *old, *with_patch, "--scratch", scratch, *checking, wanted)
