"""Which images and layers does a robot hold, and which tools?

Which layers an archive may leave out depends on the store: a classic store finds a layer by its place in a chain, a containerd store by
the digest of the blob it was loaded from. The digest is known for images that fleet sent: their OCI manifest stays on
the robot as a *receipt*, a file whose SHA-256 is the image's ID there.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fleet.images.layer import Blob

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


MOST_LEFTOVERS = 1000
"""More are removed by the next command."""

_DIGEST = re.compile("[0-9A-Za-z:._-]{1,128}").fullmatch  # of any algorithm; it becomes a part of a path
_MEDIA_TYPE = re.compile("[A-Za-z0-9][A-Za-z0-9!#$&^_.+/-]{0,254}").fullmatch


@dataclass(frozen=True, kw_only=True)
class ImageStore:
    """The images and layers on a robot, and the tools that can rebuild layers. Sizes are in bytes.

    ``chains`` are the layers (diff IDs) of each image, lowest first. ``manifests`` are the receipts of images on the robot,
    each as the blobs of its layers. ``pulled`` are the digests of blobs that came by a pull, whose layers Docker can find by
    them. ``spool`` maps a digest to the number of its bytes that have arrived. ``pins`` maps
    each release to the images it runs. ``sizes`` are the sizes of fleet's images by name, shared layers included.
    ``certs`` maps the files of registries, in ``/etc/docker/certs.d``, to their SHA-256. ``leftovers`` are files and images of interrupted commands, which `onboard/sweep.sh` may remove.
    """

    chains: tuple[tuple[str, ...], ...] = ()
    manifests: tuple[tuple[Blob, ...], ...] = ()
    pulled: frozenset[str] = frozenset()
    spool: Mapping[str, int] = field(default_factory=dict)
    pins: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sizes: Mapping[str, int] = field(default_factory=dict)
    certs: Mapping[str, str] = field(default_factory=dict)
    leftovers: tuple[str, ...] = ()
    zstd: bool = False
    python: bool = False


def parse(sections: Mapping[str, str]) -> ImageStore:
    """Read the sections that the probe prints. A missing or broken one counts as empty: then more is sent."""
    images = [line.partition(" ") for line in sections.get("layers", "").splitlines()]
    layers = {name: _layers(listing) for name, _, listing in images}
    receipts = (line.partition(" ") for line in sections.get("receipts", "").splitlines())
    manifests = (
        _blobs(text, layers[f"sha256:{digest}"])
        for digest, _, text in receipts
        if f"sha256:{digest}" in layers
    )
    tools = {path.rpartition("/")[2] for path in sections.get("tools", "").split()}
    return ImageStore(
        chains=tuple(dict.fromkeys(filter(None, layers.values()))),
        manifests=tuple(filter(None, manifests)),
        pulled=frozenset(
            digest for line in sections.get("pulled", "").splitlines() for digest in _pulled(line, layers)
        ),
        spool=_spool(sections.get("spool", "")),
        pins=_pins(sections.get("pins", "")),
        sizes=_sizes(sections.get("sizes", "")),
        certs=_certs(sections.get("certs", "")),
        leftovers=tuple(sections.get("leftovers", "").splitlines()[:MOST_LEFTOVERS]),
        zstd="zstd" in tools,
        python="python3" in tools,
    )


def _layers(listing: str) -> tuple[str, ...]:
    try:
        layers = json.loads(listing)
    except (ValueError, RecursionError):
        return ()
    if not isinstance(layers, list) or not all(isinstance(one, str) and _DIGEST(one) for one in layers):
        return ()
    return tuple(layers)


def _blobs(manifest: str, diff_ids: tuple[str, ...]) -> tuple[Blob, ...]:
    """The layers of an image's manifest, in the order of its diff IDs; () if the text is not a manifest of that image."""
    try:
        layers = json.loads(manifest)["layers"]
        blobs = tuple(
            Blob(
                diff_id=diff_id,
                digest=layer["digest"],
                size=layer["size"],
                media_type=layer["mediaType"],
            )
            for diff_id, layer in zip(diff_ids, layers, strict=True)
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        return ()
    return blobs if all(map(_is_sound, blobs)) else ()


def _pulled(manifest: str, layers: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    """The digests of the blobs of an image that was pulled and is still in a classic store, whose IDs are those of configurations."""
    try:
        described = json.loads(manifest)
        if described["config"]["digest"] in layers:
            yield from (str(layer["digest"]) for layer in described["layers"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return


def _is_sound(blob: Blob) -> bool:
    """Whether a robot's words about a blob have the form that the field has: they become an image's manifest again."""
    return (
        isinstance(blob.digest, str)
        and _DIGEST(blob.digest) is not None
        and isinstance(blob.media_type, str)
        and _MEDIA_TYPE(blob.media_type) is not None
        and type(blob.size) is int
        and 0 <= blob.size < 1 << 50
    )


def _spool(listing: str) -> dict[str, int]:
    matches = (re.fullmatch(r"([0-9a-f]{64}) ([0-9]{1,15})", line) for line in listing.splitlines())
    return {match[1]: int(match[2]) for match in matches if match}


def _certs(listing: str) -> dict[str, str]:
    """The lines of ``sha256sum``: digest by path."""
    lines = listing.splitlines()
    found = (re.fullmatch(r"([0-9a-f]{64}) [ *](/etc/docker/certs\.d/[^/]+/[^/]+)", line) for line in lines)
    return {match[2]: match[1] for match in found if match}


def _sizes(listing: str) -> dict[str, int]:
    """``talker:fleet-3f2a9c1b5d0e 241MB``: Docker prints sizes in decimal units."""
    matches = (re.fullmatch(r"(\S+) ([0-9.]{1,9})([kMG]?)B", line) for line in listing.splitlines())
    units = {"": 1, "k": 1e3, "M": 1e6, "G": 1e9}
    return {match[1]: round(_number(match[2]) * units[match[3]]) for match in matches if match}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def _pins(lines: str) -> dict[str, tuple[str, ...]]:
    """The images of each release, by ``stack/release``.

    ``.../stacks/<stack>/releases/<id>/compose.yaml:      "image": "talker:fleet-...",``: one such line for each service.
    """
    pins: dict[str, tuple[str, ...]] = {}
    for line in lines.splitlines():
        if match := _PIN.search(line):
            release = f"{match[1] or ''}/{match[2]}"
            pins[release] = (*pins.get(release, ()), match[3])
    return pins


_PIN = re.compile(
    r'\.fleet/(?:stacks/([^/]+)/)?releases/([^/]+)/compose(?:\.override)?\.yaml:\s*"image": "([^"]+)"'
)
