"""Which layers have to be sent? A pure function of the images to send and of what the robot's image store has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.images.layer import common_prefix

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from fleet.images.layer import Blob


@dataclass(frozen=True, kw_only=True)
class MissingLayers:
    """The layers of some images that are missing on a robot.

    ``send`` has their diff IDs in the order in which an engine needs them, each once. ``there`` maps the other layers to
    the blobs by which the robot knows them: containerd needs these in the manifest, a classic store knows its layers by
    diff ID alone. ``layers`` is the number of different layers of the images.
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
    """Find the layers that a robot needs to have all ``images`` (each given as its diff IDs, lowest first).

    A classic store looks a layer up by its chain: only layers that start an image on the robot may be left out. A
    containerd store looks up blobs by digest, whatever image they came with. A layer whose blob is unknown is sent,
    because the store accepts any digest in a manifest and then has a broken image.
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
