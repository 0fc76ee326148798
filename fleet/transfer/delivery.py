"""Which steps bring images to a robot, and how many bytes and seconds do they need? Pure: from images and facts to steps.

There are four strategies, each the fallback of the one before: patches where they are faster than uploading the missing
layers, the missing layers, all layers, and the plain archive of ``docker save``. The first three collect their uploads in
the robot's spool and resume after a lost connection; the last one needs nothing of the robot but Docker.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from fleet import onboard
from fleet.errors import NotReady
from fleet.images.layer import Blob
from fleet.plan.delivery import Delivery
from fleet.plan.step import ImageArchive, Step, Upload, UploadBatch
from fleet.transfer import load_archive, rebuild_command, receive
from fleet.transfer.missing import MissingLayers, missing_layers
from fleet.units import human_bytes, human_seconds

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.images.image import Image
    from fleet.robot.facts import Facts
    from fleet.transfer.load_archive import ArchiveSkeleton, TargetImage
    from fleet.transfer.rebuild_command import RebuiltLayer
    from fleet.transfer.receive import TransferRun

Strategy = Literal["patches", "missing layers", "all layers", "plain stream"]
STRATEGIES: tuple[Strategy, ...] = ("patches", "missing layers", "all layers", "plain stream")

LONG_WINDOW = 1_200_000_000
"""Bytes of memory that a robot needs for layers packed with a long window: dockerd holds the window several times."""

UNKNOWN_RATE = 2_500_000
"""Bytes per second that are assumed for a link that was never measured: a fair Wi-Fi."""

REBUILD_OVERHEAD = 2.0
"""Seconds that rebuilding a layer takes whatever its size: programs start, and files are looked up."""

REBUILD_RATE = 15_000_000
"""Bytes of a layer per second, for both passes of a rebuild: one to check it, one for Docker. A Pi 4's card reads 40 MB/s."""

SLACK = 1.05
"""File systems and image stores need a little more than the size of the files."""


def missing(images: Sequence[Image], facts: Facts, *, strategy: Strategy) -> MissingLayers:
    """The layers that the robot needs; ``all layers`` ignores what the robot seems to have."""
    believed = strategy in ("patches", "missing layers")
    return missing_layers(
        [image.layers for image in images],
        chains=facts.fleet.image_store.chains if believed else (),
        manifests=facts.fleet.image_store.manifests if believed else (),
        containerd=facts.docker.containerd,
    )


def encoding(facts: Facts) -> Literal["zstd-long", "zstd", "gzip"]:
    """The encoding of layers for a robot. Docker reads zstd from version 23 on."""
    major = facts.docker.version.partition(".")[0]
    if not (major.isdecimal() and int(major) >= 23):
        return "gzip"
    return "zstd" if 0 < facts.host.memory < LONG_WINDOW else "zstd-long"


def layers(
    images: Sequence[tuple[Image, TargetImage]],
    *,
    missing: MissingLayers,
    packed: Mapping[str, Blob],
    rebuilt: Mapping[str, RebuiltLayer],
    facts: Facts,
    run: TransferRun,
) -> Delivery:
    """Upload the missing layers, and let the robot rebuild those in ``rebuilt``.

    ``packed`` has the layers as they are uploaded; both are by diff ID.

    Raises:
        NotReady: the robot's disk is too small for them.

    """
    blobs = {**packed, **{diff_id: Blob.plain(diff_id, layer.size) for diff_id, layer in rebuilt.items()}}
    members = tuple({blobs[diff_id].digest: blobs[diff_id] for diff_id in missing.send}.values())
    targets = [target for _, target in images]
    skeleton = load_archive.skeleton(targets, blobs={**missing.there, **blobs}, sent=members)
    label = f"{len(members)} of {missing.layers} layers"
    batch = UploadBatch(label=label, to=run.to, pieces=_uploads(skeleton, members, rebuilt, facts))
    after = _check_disk(members, batch, facts)
    rebuilding = f", {_rebuild_summary(rebuilt)}" if rebuilt else ""
    return Delivery(
        steps=(
            receive.step(batch, skeleton, members, rebuilt, title=f"send {label}{rebuilding}", run=run),
            *(prove(image) for image, _ in images),
        ),
        forecast="; ".join(
            (f"lacks {label}, {_cost(batch, run.rate)}{rebuilding}", disk(facts.disk.free, after))
        ),
        transfer=f"{label}{rebuilding}",
    )


def can_rebuild(facts: Facts) -> bool:
    """Whether the robot can make a layer from one that it has: that takes root, who may read Docker's files."""
    return (
        facts.fleet.image_store.python
        and facts.fleet.image_store.zstd
        and facts.login.sudo in ("root", "free")
    )


def rebuilding_is_faster(packed: Blob, *, patch: int, rate: float | None) -> bool:
    """Whether rebuilding the layer on the robot is faster than uploading it. ``patch`` is in bytes."""
    saved = (packed.size - patch) / (rate or UNKNOWN_RATE)
    return saved > REBUILD_OVERHEAD + packed.unpacked / REBUILD_RATE


def _uploads(
    skeleton: ArchiveSkeleton, members: Sequence[Blob], rebuilt: Mapping[str, RebuiltLayer], facts: Facts
) -> tuple[Upload, ...]:
    """The skeleton, the layers that are uploaded, and the program and patches for those that are rebuilt."""
    uploads = [Upload(digest=skeleton.hex, size=len(skeleton.data), data=skeleton.data)]
    if rebuilt:
        program = rebuild_command.program()
        uploads.append(Upload(digest=rebuild_command.program_digest(), size=len(program), data=program))
    for blob in members:
        if blob.diff_id not in rebuilt:
            uploads.append(Upload(digest=blob.hex, size=blob.size))
        elif patch := rebuilt[blob.diff_id].patch:
            uploads.append(patch)
    spool = facts.fleet.image_store.spool
    return tuple(replace(each, there=min(spool.get(each.digest, 0), each.size)) for each in uploads)


def _rebuild_summary(rebuilt: Mapping[str, RebuiltLayer]) -> str:
    patched = sum(layer.patch is not None for layer in rebuilt.values())
    copied = len(rebuilt) - patched
    parts = (f"{patched} of them as patches" * (patched > 0), f"{copied} copied there" * (copied > 0))
    return " and ".join(filter(None, parts))


def _cost(batch: UploadBatch, rate: float | None) -> str:
    """Bytes and seconds of a batch, in words."""
    arrived = sum(upload.there for upload in batch.pieces)
    earlier = f" ({human_bytes(arrived)} sent earlier)" if arrived else ""
    seconds = batch.size / rate if rate else 0
    at = f", about {human_seconds(seconds)} at {human_bytes(rate)}/s" if rate and seconds >= 1 else ""
    return f"{human_bytes(batch.size)} packed{earlier}{at}"


def disk(free: float, after: float) -> str:
    """The free bytes now and afterwards, in words."""
    return f"disk: {human_bytes(free)} free, {human_bytes(after)} afterwards"


def stream(images: Sequence[Image], *, facts: Facts) -> Delivery:
    """Send whole images from ``docker save`` to ``docker load``: the strategy that always works.

    Raises:
        NotReady: the robot's disk is too small for them.

    """
    size = sum(image.size for image in images)
    refuse(2 * SLACK * size, facts)
    steps = (step for image in images for step in (_load(image), prove(image)))
    return Delivery(
        steps=tuple(steps), forecast=f"sends {human_bytes(size)}, whole images", transfer="whole images"
    )


def _check_disk(sent: Sequence[Blob], batch: UploadBatch, facts: Facts) -> float:
    """Check that the layers fit on the disk; return the bytes that will be free afterwards.

    At the peak the disk holds the packed layers twice (spool, Docker's copy of the archive) and the unpacked ones. A
    containerd store keeps the packed layers.
    """
    packed = sum(blob.size for blob in sent)
    unpacked = SLACK * sum(blob.unpacked for blob in sent)
    refuse(packed + unpacked + (batch.size if facts.disk.shared else 0), facts)
    if not facts.disk.shared and batch.size > facts.disk.home_free:
        raise NotReady(
            f"its home directory needs {human_bytes(batch.size)} of free disk for the upload, "
            f"and has {human_bytes(facts.disk.home_free)}",
            cure="free some there: the upload is gathered in ~/.fleet/spool",
        )
    return facts.disk.free - unpacked - (packed if facts.docker.containerd else 0)


def refuse(needed: float, facts: Facts) -> None:
    """Raise `NotReady` if the robot's disk has fewer free bytes than are needed."""
    if needed > facts.disk.free:
        raise NotReady(
            f"it needs {human_bytes(needed)} of free disk, and has {human_bytes(facts.disk.free)}",
            cure="`fab prune` removes old releases; `docker system df` on the robot shows what Docker uses",
        )


def _load(image: Image) -> Step:
    return Step(
        title=f"load {image.shipped_as}",
        argv=("docker", "load", "--quiet"),
        feed=ImageArchive(image=image.reference, reference=image.shipped_as, size=image.size),
        limit=None,
        harmless=True,
        resumes=True,
    )


def prove(image: Image) -> Step:
    """Prove an image by its identity: a containerd store prints ``Loaded image`` even for a broken one."""
    return Step(
        title="prove that the image arrived unchanged",
        argv=(
            *("sh", "-c", onboard.text("prove_image.sh"), "prove_image"),
            *(image.shipped_as, image.identity, image.fingerprint),
        ),
        harmless=True,
        resumes=True,
        cure="run the same command again",
    )
