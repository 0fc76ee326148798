"""What of images does a robot hold? The part of the probe that asks, and the value its answer becomes.

What may be left out of an archive differs: a classic store finds a layer by its place in a chain, a containerd store by
the digest of the blob it was loaded from. The second is known for images that fleet sent: their OCI manifest stays on
the robot as a *receipt*, a file whose SHA-256 is the image's ID there.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fleet.images.layer import Blob

if TYPE_CHECKING:
    from collections.abc import Mapping

PROBE = r"""
if command -v docker >/dev/null; then
  section layers; docker image ls -aq --no-trunc 2>/dev/null | sort -u |
    xargs -r docker image inspect --format '{{.Id}} {{json .RootFS.Layers}}' 2>/dev/null
fi
section sizes; docker image ls --format '{{.Repository}}:{{.Tag}} {{.Size}}' 2>/dev/null | grep ':fleet-'
section receipts; for file in "$HOME"/.fleet/receipts/*; do
  [ -f "$file" ] && printf '%s ' "$(sha256sum < "$file" | cut -c1-64)" && tr -d '\n' < "$file" && echo; done
section spool; cd "$HOME/.fleet/spool" 2>/dev/null && stat -c '%n %s' * 2>/dev/null; cd
section pins; grep -H '"image":' "$HOME"/.fleet/releases/*/compose.override.yaml 2>/dev/null
section tools; command -v zstd; python3 -c "import argparse, json, zlib" 2>/dev/null && echo python3
section memory; sed -n 's/^MemTotal: *\([0-9]*\) kB$/\1/p' /proc/meminfo
"""
"""Sections for `fleet.robot.probe.PROBE`; like those, they look and never touch."""


@dataclass(frozen=True, kw_only=True)
class ImageStore:
    """What a robot holds of images, and what it can do with them. Sizes are in bytes.

    ``chains`` are the layers (diff IDs) of each image, lowest first. ``manifests`` holds the receipts of images that are
    there, each as its layers' blobs. ``spool`` maps digests to the bytes of them that have arrived. ``pins`` maps each
    release to the images it runs. ``sizes`` are those of fleet's images by name, layers that others share included.
    """

    chains: tuple[tuple[str, ...], ...] = ()
    manifests: tuple[tuple[Blob, ...], ...] = ()
    spool: Mapping[str, int] = field(default_factory=dict)
    pins: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sizes: Mapping[str, int] = field(default_factory=dict)
    zstd: bool = False
    python: bool = False
    memory: int = 0


def parse(said: Mapping[str, str]) -> ImageStore:
    """Read the sections of `PROBE`. What is missing or broken is not there: then more is sent than had to be."""
    images = [line.partition(" ") for line in said.get("layers", "").splitlines()]
    layers = {name: _layers(listing) for name, _, listing in images}
    receipts = (line.partition(" ") for line in said.get("receipts", "").splitlines())
    manifests = (
        _blobs(text, layers[f"sha256:{digest}"])
        for digest, _, text in receipts
        if f"sha256:{digest}" in layers
    )
    tools = {path.rpartition("/")[2] for path in said.get("tools", "").split()}
    memory = said.get("memory", "")
    return ImageStore(
        chains=tuple(dict.fromkeys(filter(None, layers.values()))),
        manifests=tuple(filter(None, manifests)),
        spool=_spool(said.get("spool", "")),
        pins=_pins(said.get("pins", "")),
        sizes=_sizes(said.get("sizes", "")),
        zstd="zstd" in tools,
        python="python3" in tools,
        memory=int(memory) * 1024 if re.fullmatch("[0-9]{1,15}", memory) else 0,
    )


def _layers(listing: str) -> tuple[str, ...]:
    try:
        said = json.loads(listing)
    except (ValueError, RecursionError):
        return ()
    return tuple(map(str, said)) if isinstance(said, list) else ()


def _blobs(manifest: str, diff_ids: tuple[str, ...]) -> tuple[Blob, ...]:
    """A manifest's layers, which are those of the image in the same order; () where it is no manifest of it."""
    try:
        layers = json.loads(manifest)["layers"]
        blobs = tuple(
            Blob(
                diff_id=diff_id,
                digest=layer["digest"],
                size=int(layer["size"]),
                media_type=layer["mediaType"],
            )
            for diff_id, layer in zip(diff_ids, layers, strict=True)
        )
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return ()
    words = (word for blob in blobs for word in (blob.digest, blob.media_type))
    return blobs if all(isinstance(word, str) for word in words) else ()


def _spool(said: str) -> dict[str, int]:
    found = (re.fullmatch(r"([0-9a-f]{64}) ([0-9]{1,15})", line) for line in said.splitlines())
    return {match[1]: int(match[2]) for match in found if match}


def _sizes(said: str) -> dict[str, int]:
    """``talker:fleet-3f2a9c1b5d0e 241MB``: Docker says sizes in decimal units."""
    found = (re.fullmatch(r"(\S+) ([0-9.]{1,9})([kMG]?)B", line) for line in said.splitlines())
    units = {"": 1, "k": 1e3, "M": 1e6, "G": 1e9}
    return {match[1]: round(_number(match[2]) * units[match[3]]) for match in found if match}


def _number(said: str) -> float:
    try:
        return float(said)
    except ValueError:
        return 0.0


def _pins(said: str) -> dict[str, tuple[str, ...]]:
    """``.../releases/<id>/compose.override.yaml:  "image": "talker:fleet-...",``: fleet writes one such line a service."""
    pins: dict[str, tuple[str, ...]] = {}
    for line in said.splitlines():
        if found := re.search(r'/releases/([^/]+)/compose\.override\.yaml:\s*"image": "([^"]+)"', line):
            pins[found[1]] = (*pins.get(found[1], ()), found[2])
    return pins
