"""Which steps let a robot pull images from a registry, and how many bytes does it pull? Pure, as `fleet.transfer.delivery`.

The manifest is the one that an upload would have, so an image has the same ID whichever way it came. The robot pulls it by
its digest. Docker skips the layers that it has, if it knows them by the digest of their blob: a containerd store knows all
blobs of its images, a classic store only those that it has pulled before.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import takewhile
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.config.image_reference import path
from fleet.images.layer import common_prefix
from fleet.plan.delivery import Delivery
from fleet.plan.step import Pull, Pulled, Step
from fleet.transfer import delivery, load_archive
from fleet.transfer.receive import STALE
from fleet.units import human_bytes, human_seconds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from fleet.config.inventory import Robot
    from fleet.config.registry import Registry
    from fleet.images.image import Image
    from fleet.images.layer import Blob
    from fleet.robot.facts import Facts
    from fleet.transfer.load_archive import TargetImage
    from fleet.transfer.receive import TransferRun


def needed(image: Image, facts: Facts, *, robot: Robot) -> tuple[str, ...]:
    """The layers of an image (diff IDs) that have to be packed: a classic store may ask for all, and a registry wants all."""
    if robot.registry or not facts.docker.containerd:
        return tuple(dict.fromkeys(image.layers))
    return delivery.missing([image], facts, strategy="missing layers").send


def plan(
    images: Sequence[tuple[Image, TargetImage]],
    *,
    packed: Mapping[str, Blob],
    robot: Robot,
    facts: Facts,
    run: TransferRun,
) -> Delivery:
    """Let the robot pull ``images``, whose layers are ``packed`` by diff ID as far as they are `needed`.

    Raises:
        NotReady: the robot's disk is too small for them.

    """
    there = delivery.missing([image for image, _ in images], facts, strategy="missing layers").there
    blobs = {**there, **packed}  # those that were packed here win: a registry has them
    named = [described(image, target, blobs, registry=robot.registry) for image, target in images]
    lacks = tuple({blob.digest: blob for one in named for blob in _lacks(one, facts)}.values())
    size = sum(blob.size for blob in lacks)
    layers = len({blob.digest for one in named for blob in one.blobs})
    after = _check_disk(lacks, facts)
    where = f"the registry {robot.registry.host}" if robot.registry else "this computer, through SSH"
    label = f"{len(lacks)} of {layers} layers"
    feed = Pull(label=f"{label} from {where}", images=tuple(named), bytes=size, registry=robot.registry)
    return Delivery(
        steps=(
            _step(feed, robot=robot, facts=facts, run=run),
            *(delivery.prove(image) for image, _ in images),
        ),
        forecast="; ".join(
            (f"lacks {label}, pulls {_cost(feed, run.rate)}", delivery.disk(facts.disk.free, after))
        ),
        transfer=f"{label}, pulled {human_bytes(size)} from {where}",
        way=f"registry {robot.registry.host}" if robot.registry else "registry through SSH",
    )


def after_push(planned: Delivery, lacking: Sequence[Blob]) -> Delivery:
    """Say in the forecast what the registry gets first."""
    size = sum(blob.size for blob in lacking)
    first = f"; this computer first pushes {human_bytes(size)} there" if lacking else ""
    return replace(planned, forecast=planned.forecast + first)


def described(
    image: Image, target: TargetImage, blobs: Mapping[str, Blob], *, registry: Registry | None
) -> Pulled:
    """An image as it is in a registry; ``blobs`` has all its layers by diff ID."""
    prefix = registry.prefix if registry else ""
    return Pulled(
        name=image.shipped_as,
        path=prefix + path(image.reference),
        manifest=load_archive.manifest_of(target, blobs),
        config=target.config,
        blobs=tuple(blobs[diff_id] for diff_id in target.diff_ids),
    )


def _lacks(image: Pulled, facts: Facts) -> Iterator[Blob]:
    """The blobs that Docker will ask for."""
    store = facts.fleet.image_store
    diff_ids = tuple(blob.diff_id for blob in image.blobs)
    if facts.docker.containerd:
        known = {blob.digest for blobs in store.manifests for blob in blobs}
        yield from (blob for blob in image.blobs if blob.digest not in known)
        return
    chain = max((common_prefix(diff_ids, one) for one in store.chains), default=0)
    have = sum(1 for _ in takewhile(lambda blob: blob.digest in store.pulled, image.blobs[:chain]))
    yield from image.blobs[have:]


def _check_disk(lacks: Sequence[Blob], facts: Facts) -> float:
    """Check that the layers fit on the disk; return the bytes that will be free afterwards. While it pulls, Docker keeps them packed too."""
    packed = sum(blob.size for blob in lacks)
    unpacked = delivery.SLACK * sum(blob.unpacked for blob in lacks)
    delivery.refuse(packed + unpacked, facts)
    return facts.disk.free - unpacked - (packed if facts.docker.containerd else 0)


def _cost(feed: Pull, rate: float | None) -> str:
    seconds = feed.size / rate if rate else 0
    at = f", about {human_seconds(seconds)} at {human_bytes(rate)}/s" if rate and seconds >= 1 else ""
    return f"{human_bytes(feed.bytes)}{at}"


def _step(feed: Pull, *, robot: Robot, facts: Facts, run: TransferRun) -> Step:
    by = "_".join(run.by.split())
    emulated = robot.platform if robot.platform != (*facts.host.platforms, robot.platform)[0] else ""
    words = (
        (one.path, one.digest, one.name.rpartition(":fleet-")[2], one.name, one.identity)
        for one in feed.images
    )
    return Step(
        title=f"pull {feed.label}",
        argv=(
            *("sh", "-c", onboard.text("pull_images.sh"), "pull_images"),
            *(run.token, by, load_archive.INCOMING, str(STALE), emulated),
            *(word for image in words for word in image),
        ),
        feed=feed,
        limit=None,
        harmless=True,
        resumes=True,
    )
