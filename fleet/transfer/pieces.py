"""Which layers have to be sent? A pure function of the images that are wanted and of what a robot holds."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


PLAIN = "application/vnd.oci.image.layer.v1.tar"
"""The media type of a layer's tar; what is packed adds to it (opencontainers/image-spec, layer.md)."""


@dataclass(frozen=True, kw_only=True)
class Blob:
    """A layer as it travels and as a containerd store keeps it.

    ``diff_id`` is the digest of its tar, ``digest`` that of these bytes (``sha256:...``), ``size`` their number.
    ``media_type`` is OCI's. ``unpacked`` is the size of the tar in bytes, 0 where nobody has counted.
    """

    diff_id: str
    digest: str
    size: int
    media_type: str
    unpacked: int = 0

    @classmethod
    def plain(cls, diff_id: str, size: int) -> Blob:
        """A layer's tar as it is."""
        return cls(diff_id=diff_id, digest=diff_id, size=size, media_type=PLAIN, unpacked=size)

    @property
    def hex(self) -> str:
        """The digest without its algorithm."""
        return self.digest.removeprefix("sha256:")


@dataclass(frozen=True, kw_only=True)
class Lack:
    """What a robot lacks of some images.

    ``send`` are diff IDs in the order in which an engine needs them, each once. ``there`` maps the others to the blobs
    they are known by: containerd needs these in the manifest, a classic store knows its layers by diff ID alone.
    ``layers`` is how many different layers the images have.
    """

    send: tuple[str, ...]
    there: Mapping[str, Blob]
    layers: int


def lacking(
    images: Sequence[tuple[str, ...]],
    *,
    chains: Iterable[tuple[str, ...]],
    manifests: Iterable[Sequence[Blob]],
    containerd: bool,
) -> Lack:
    """What must be sent so that a robot has all of ``images`` (each its diff IDs, lowest first).

    A classic store looks a layer up by its chain: only a prefix of an image that is there may be left out. A containerd store looks up blobs by digest, wherever they came from;
    a layer whose blob is not known is sent, because the store believes any digest and then holds a broken image.
    """
    everything = dict.fromkeys(diff_id for image in images for diff_id in image)
    known = {blob.diff_id: blob for blobs in manifests for blob in blobs} if containerd else {}
    if containerd:
        send = [diff_id for diff_id in everything if diff_id not in known]
        return Lack(
            send=tuple(send),
            there={diff_id: known[diff_id] for diff_id in everything if diff_id in known},
            layers=len(everything),
        )
    have = tuple(chains)
    send = []
    for image in images:
        send += image[max((common(image, chain) for chain in have), default=0) :]
    return Lack(send=tuple(dict.fromkeys(send)), there={}, layers=len(everything))


def chain_id(diff_ids: Sequence[str]) -> str:
    """The name of a chain of layers, lowest first, in a classic store (opencontainers/image-spec, config.md)."""
    chain = diff_ids[0]
    for diff_id in diff_ids[1:]:
        chain = f"sha256:{hashlib.sha256(f'{chain} {diff_id}'.encode()).hexdigest()}"
    return chain


def common(one: Sequence[str], other: Sequence[str]) -> int:
    """The length of their common prefix."""
    pairs = zip(one, other, strict=False)
    return next((count for count, (a, b) in enumerate(pairs) if a != b), min(len(one), len(other)))
