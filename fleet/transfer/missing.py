"""Which layers have to be sent? A pure function of the images that are wanted and of what a robot holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
from fleet.images.layer import Blob, common_prefix


@dataclass(frozen=True, kw_only=True)
class MissingLayers:
    """What a robot lacks of some images.

    ``send`` are diff IDs in the order in which an engine needs them, each once. ``there`` maps the others to the blobs
    they are known by: containerd needs these in the manifest, a classic store knows its layers by diff ID alone.
    ``layers`` is how many different layers the images have.
    """

    send: tuple[str, ...]
    there: Mapping[str, Blob]
    layers: int


def missing_layers(
    images: Sequence[tuple[str, ...]],
    *,
    chains: Iterable[tuple[str, ...]],
    manifests: Iterable[Sequence[Blob]],
    containerd: bool,
) -> MissingLayers:
    """What must be sent so that a robot has all of ``images`` (each its diff IDs, lowest first).

    A classic store looks a layer up by its chain: only a prefix of an image that is there may be left out. A containerd store looks up blobs by digest, wherever they came from;
    a layer whose blob is not known is sent, because the store believes any digest and then holds a broken image.
    """
    everything = dict.fromkeys(diff_id for image in images for diff_id in image)
    known = {blob.diff_id: blob for blobs in manifests for blob in blobs} if containerd else {}
    if containerd:
        send = [diff_id for diff_id in everything if diff_id not in known]
        return MissingLayers(
            send=tuple(send),
            there={diff_id: known[diff_id] for diff_id in everything if diff_id in known},
            layers=len(everything),
        )
    have = tuple(chains)
    send = []
    for image in images:
        send += image[max((common_prefix(image, chain) for chain in have), default=0) :]
    return MissingLayers(send=tuple(dict.fromkeys(send)), there={}, layers=len(everything))
