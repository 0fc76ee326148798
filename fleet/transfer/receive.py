"""The command that a robot runs to receive images: ``onboard/receive.sh`` and its arguments.

The script collects uploads in a spool and loads them into Docker when all are complete. Uploads are named by their digest,
so an interrupted upload resumes at the byte where it stopped, from any desktop, and damaged bytes are never used. An image
is first loaded under a private name; it gets the name that releases use only after it is proved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.plan.step import Step
from fleet.transfer import load_archive, rebuild_command

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.images.layer import Blob
    from fleet.plan.step import UploadBatch
    from fleet.transfer.load_archive import ArchiveSkeleton
    from fleet.transfer.rebuild_command import RebuiltLayer

STALE = 70
"""Seconds without a byte after which a transfer counts as dead; also how long a transfer waits for another one to end."""


@dataclass(frozen=True, kw_only=True)
class TransferRun:
    """One run's transfer to one robot.

    ``to`` is the robot's address, ``token`` identifies the run, ``by`` is who ships (``tim@desktop``), and ``rate`` is
    the last known rate of the link in bytes per second.
    """

    to: str
    token: str
    by: str
    rate: float | None = None


def step(
    batch: UploadBatch,
    skeleton: ArchiveSkeleton,
    members: Sequence[Blob],
    rebuilt: Mapping[str, RebuiltLayer],
    *,
    title: str,
    run: TransferRun,
) -> Step:
    """Receive a batch of uploads, and load the archive of ``skeleton`` and the layers ``members`` into Docker.

    The robot makes the layers in ``rebuilt`` (by diff ID) itself.
    """
    by = "_".join(run.by.split())
    uploads = (f"upload {upload.digest} {upload.size}" for upload in batch.pieces)
    layers = (f"layer {blob.hex} {blob.size} {_origin(blob, rebuilt.get(blob.diff_id))}" for blob in members)
    images = (
        f"image {m.image.incoming} {m.image.fingerprint} {m.image.name} {' '.join(m.ids)} {m.offset} {m.length}"
        for m in skeleton.manifests
    )
    return Step(
        title=title,
        argv=(
            *("sh", "-c", onboard.text("receive.sh"), "receive"),
            *(run.token, by, skeleton.hex, load_archive.INCOMING, str(STALE)),
            *(*uploads, *layers, *images),
        ),
        feed=batch,
        limit=None,
        harmless=True,
        resumes=True,
    )


def _origin(blob: Blob, rebuilt: RebuiltLayer | None) -> str:
    """How a layer gets into the archive: ``cat`` reads the uploaded file; anything else is a command that writes the layer."""
    if rebuilt is None:
        return "cat"
    patch = rebuilt.patch.digest if rebuilt.patch else ""
    program = rebuild_command.program_digest()
    return " ".join(rebuild_command.argv(program, rebuilt.source.where, wanted=blob.diff_id, patch=patch))
