"""Which steps bring images to a robot, and what will that take? Pure: from what is wanted and what is there to steps.

There are four ways, each the fallback of the one before: patches where they are quicker than the layers that are missing,
these layers, all layers, and the plain archive of ``docker save``. All but the last are gathered in the robot's spool and
go on after a cut; the last needs nothing of the robot.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from fleet.errors import NotReady
from fleet.images.identity import IDENTITY
from fleet.images.layer import Blob
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
from fleet.plan.delivery import Delivery

Strategy = Literal["patches", "missing layers", "all layers", "plain stream"]
STRATEGIES: tuple[Strategy, ...] = ("patches", "missing layers", "all layers", "plain stream")

LONG_WINDOW = 1_200_000_000
"""Bytes of memory a robot has that gets layers packed with a long window: dockerd keeps it several times while it unpacks."""

UNKNOWN_RATE = 2_500_000
"""Bytes per second that a link is taken for as long as nobody has measured it: a fair Wi-Fi."""

MAKING = 2.0
"""Seconds a robot needs for making a layer beside those that depend on its size: it starts programs, and looks at files."""

MADE_PER_SECOND = 15_000_000
"""Bytes of a layer that a robot makes in a second, both times: once to check, once for Docker. A Pi 4's card reads 40 MB."""

SLACK = 1.05
"""File systems and stores add a little to what they hold."""


def lack(images: Sequence[Image], facts: Facts, *, way: Strategy) -> MissingLayers:
    """What must be sent of some images; ``all layers`` believes nothing of what seems to be there."""
    believed = way in ("patches", "missing layers")
    return missing_layers(
        [image.layers for image in images],
        chains=facts.fleet.image_store.chains if believed else (),
        manifests=facts.fleet.image_store.manifests if believed else (),
        containerd=facts.docker.containerd,
    )


def encoding(facts: Facts) -> Literal["zstd-long", "zstd", "gzip"]:
    """How layers are packed for a robot: Docker reads zstd from version 23 on."""
    major = facts.docker.version.partition(".")[0]
    if not (major.isdecimal() and int(major) >= 23):
        return "gzip"
    return "zstd" if 0 < facts.host.memory < LONG_WINDOW else "zstd-long"


def pieces(
    images: Sequence[tuple[Image, TargetImage]],
    *,
    lack: MissingLayers,
    packed: Mapping[str, Blob],
    made: Mapping[str, RebuiltLayer],
    facts: Facts,
    shipment: TransferRun,
) -> Delivery:
    """Send the layers that a robot lacks, or have it make those that are in ``made``.

    ``packed`` are the layers as they are sent.

    Raises:
        NotReady: the robot's disk would not hold them.

    """
    blobs = {**packed, **{one: Blob.plain(one, layer.size) for one, layer in made.items()}}
    members = tuple({blobs[one].digest: blobs[one] for one in lack.send}.values())
    frame = load_archive.frame([wanted for _, wanted in images], blobs={**lack.there, **blobs}, sent=members)
    label = f"{len(members)} of {lack.layers} layers"
    parcel = UploadBatch(label=label, to=shipment.to, pieces=_parts(frame, members, made, facts))
    after = _room(members, parcel, facts)
    making = f", {_makes(made)}" if made else ""
    return Delivery(
        steps=(
            receive.step(parcel, frame, members, made, title=f"send {label}{making}", shipment=shipment),
            *(_prove(image) for image, _ in images),
        ),
        forecast="; ".join(
            (f"lacks {label}, {_takes(parcel, shipment.rate)}{making}", _disk(facts.disk.free, after))
        ),
        transfer=f"{label}{making}",
    )


def may_make(facts: Facts) -> bool:
    """Whether a robot can make a layer of another one: only root may read Docker's."""
    return (
        facts.fleet.image_store.python
        and facts.fleet.image_store.zstd
        and facts.login.sudo in ("root", "free")
    )


def saves(packed: Blob, *, patch: int, rate: float | None) -> bool:
    """Whether a layer is there sooner when the robot makes it with a patch of so many bytes than when it is sent."""
    sooner = (packed.size - patch) / (rate or UNKNOWN_RATE)
    return sooner > MAKING + packed.unpacked / MADE_PER_SECOND


def _parts(
    frame: ArchiveSkeleton, members: Sequence[Blob], made: Mapping[str, RebuiltLayer], facts: Facts
) -> tuple[Upload, ...]:
    """The frame, the layers that are sent, and what others are made with."""
    parts = [Upload(digest=frame.hex, size=len(frame.data), data=frame.data)]
    if made:
        program = rebuild_command.program()
        parts.append(Upload(digest=rebuild_command.program_digest(), size=len(program), data=program))
    for blob in members:
        if blob.diff_id not in made:
            parts.append(Upload(digest=blob.hex, size=blob.size))
        elif patch := made[blob.diff_id].patch:
            parts.append(patch)
    return tuple(
        replace(part, there=min(facts.fleet.image_store.spool.get(part.digest, 0), part.size))
        for part in parts
    )


def _makes(made: Mapping[str, RebuiltLayer]) -> str:
    patched = sum(layer.patch is not None for layer in made.values())
    copied = len(made) - patched
    ways = (f"{patched} of them as patches" * (patched > 0), f"{copied} copied there" * (copied > 0))
    return " and ".join(filter(None, ways))


def _takes(parcel: UploadBatch, rate: float | None) -> str:
    """Bytes and seconds of a parcel, in words."""
    came = sum(piece.there for piece in parcel.pieces)
    earlier = f" ({human_bytes(came)} came earlier)" if came else ""
    seconds = parcel.size / rate if rate else 0
    at = f", about {human_seconds(seconds)} at {human_bytes(rate)}/s" if rate and seconds >= 1 else ""
    return f"{human_bytes(parcel.size)} packed{earlier}{at}"


def _disk(free: float, after: float) -> str:
    return f"disk: {human_bytes(free)} free, {human_bytes(after)} afterwards"


def stream(images: Sequence[Image], *, facts: Facts) -> Delivery:
    """Send whole images as ``docker save`` writes them, into ``docker load``: what always works.

    Raises:
        NotReady: the robot's disk would not hold them.

    """
    size = sum(image.size for image in images)
    _refuse(2 * SLACK * size, facts)
    steps = (step for image in images for step in (_load(image), _prove(image)))
    return Delivery(
        steps=tuple(steps), forecast=f"sends {human_bytes(size)}, whole images", transfer="whole images"
    )


def _room(sent: Sequence[Blob], parcel: UploadBatch, facts: Facts) -> float:
    """Refuse what does not fit; the bytes that will be free afterwards.

    At the peak the spool and Docker's own copy of the archive are there, packed, and the layers, unpacked. A containerd
    store keeps the packed ones.
    """
    packed = sum(blob.size for blob in sent)
    unpacked = SLACK * sum(blob.unpacked for blob in sent)
    _refuse(parcel.size + packed + unpacked, facts)
    return facts.disk.free - unpacked - (packed if facts.docker.containerd else 0)


def _refuse(needed: float, facts: Facts) -> None:
    if needed > facts.disk.free:
        raise NotReady(
            f"it needs {human_bytes(needed)} of free disk, and has {human_bytes(facts.disk.free)}",
            cure="`fab prune` removes old releases; `docker system df` there shows what Docker uses",
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


def _prove(image: Image) -> Step:
    """`docker load` is not believed: a containerd store says ``Loaded image`` of a broken one."""
    return Step(
        title="prove that what arrived is what was sent",
        argv=("docker", "image", "inspect", "--format", IDENTITY, image.shipped_as),
        expect=image.identity,
        harmless=True,
        resumes=True,
        cure="run the same command again",
    )
