"""How do images get from this computer's Docker to many robots? Each layer is packed once and sent to every robot."""

from __future__ import annotations

import contextlib
import secrets
from typing import TYPE_CHECKING, Protocol, Self

from fleet.plan.delivery import Delivery
from fleet.plan.step import ImageArchive, Pull, UploadBatch
from fleet.transfer import delivery, pull, rebuild_command
from fleet.transfer.layer_cache import LayerCache, folder
from fleet.transfer.link_rates import LinkRates, lowest
from fleet.transfer.load_archive import TargetImage
from fleet.transfer.patch_cache import PatchCache
from fleet.transfer.pull_server import PullFeed, PullServer
from fleet.transfer.rebuild_command import RebuiltLayer
from fleet.transfer.receive import TransferRun
from fleet.transfer.registry_push import Registries
from fleet.transfer.upload_server import UploadServer

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.images.layer import Blob
    from fleet.plan.step import Feed
    from fleet.robot.facts import Facts
    from fleet.transfer.codec import Encoding
    from fleet.transfer.delivery import Strategy
    from fleet.transfer.rate_limit import RateLimiter
    from fleet.transfer.rebuild_command import Source
    from fleet.transfer.registry_push import Logins


class Images(Protocol):
    """Where images come from: this computer's Docker (`fleet.images.store.Store`), or a bundle."""

    def export(self, wanted: Image, /) -> Iterable[bytes]:
        """The image as ``docker save`` writes it."""

    def archive(self, local: str, reference: str, /) -> Iterable[bytes]:
        """The image ``local`` as ``docker save`` writes it, named ``reference``."""

    def pushed(self, wanted: Image, layers: Collection[str], /) -> AbstractContextManager[Mapping[str, Path]]:
        """A quicker way to the configuration and some ``layers``, as files by digest; nothing if there is none."""

    def prime(self, wanted: Image, /) -> None:
        """Prepare the quicker way for the next time."""


class Sender:
    """The transfers of one run of `fab ship`.

    ``archive`` reads an image out of Docker, as `fleet.images.store.Store.archive` does. ``logins`` finds the login of a
    registry. ``rates`` is the file with the measured rates of links; it may be removed at any time.
    """

    def __init__(
        self,
        *,
        cache: LayerCache,
        limiter: RateLimiter,
        by: str,
        rates: Path,
        archive: Callable[[str, str], Iterable[bytes]],
        logins: Logins = lambda _: None,
    ) -> None:
        self._cache = cache
        self._patches = PatchCache(cache)
        self._limiter = limiter
        self._by = by
        self._rates = LinkRates(rates)
        self._archive = archive
        self._registries = Registries(open_blob=cache.open, logins=logins)
        self._token = secrets.token_hex(8)

    @classmethod
    @contextlib.contextmanager
    def using(
        cls, store: Images, *, limiter: RateLimiter, by: str, logins: Logins = lambda _: None
    ) -> Generator[Self]:
        """A sender of images, whose cache is reduced to its maximum size at the end."""
        directory = folder()
        cache = LayerCache(
            directory=directory, export=store.export, pushed=store.pushed, exported=store.prime
        )
        rates = directory.parent / "rates.json"
        try:
            yield cls(cache=cache, limiter=limiter, by=by, rates=rates, archive=store.archive, logins=logins)
        finally:
            cache.tidy()

    def deliver(self, images: Sequence[Image], *, robot: Robot, facts: Facts, strategy: Strategy) -> Delivery:
        """The steps that bring images to a robot.

        Raises:
            NotReady: the robot's disk is too small for the images.
            DesktopError: this computer's Docker cannot export the images.

        """
        if not images:
            return Delivery()
        if robot.transport == "registry":
            return self._pull(images, robot=robot, facts=facts)
        if strategy == "plain stream":
            return delivery.stream(images, facts=facts)
        missing = delivery.missing(images, facts, strategy=strategy)
        encoding, rate = delivery.encoding(facts), self._rate(robot)
        packed = self._packed(dict.fromkeys(images, missing.send), encoding)
        return delivery.layers(
            tuple((image, self._target(image)) for image in images),
            missing=missing,
            packed=packed,
            rebuilt=self._rebuilt(images, packed, facts, rate=rate) if strategy == "patches" else {},
            facts=facts,
            run=self._run(robot),
        )

    def _pull(self, images: Sequence[Image], *, robot: Robot, facts: Facts) -> Delivery:
        wanted = {image: pull.needed(image, facts, robot=robot) for image in images}
        planned = pull.plan(
            tuple((image, self._target(image)) for image in images),
            packed=self._packed(wanted, delivery.encoding(facts)),
            robot=robot,
            facts=facts,
            run=self._run(robot),
        )
        if not robot.registry:
            return planned
        pulled = [one for step in planned.steps if isinstance(step.feed, Pull) for one in step.feed.images]
        return pull.after_push(planned, self._registries.lacks(robot.registry, pulled))

    def _packed(self, wanted: Mapping[Image, Collection[str]], encoding: Encoding) -> dict[str, Blob]:
        """The layers of images that are wanted of each, packed, by diff ID. Those that images share are packed once."""
        packed: dict[str, Blob] = {}
        for image, diff_ids in wanted.items():
            new = [diff_id for diff_id in image.layers if diff_id in diff_ids and diff_id not in packed]
            packed |= self._cache.pack(image, new, encoding) if new else {}
        return packed

    def _run(self, robot: Robot) -> TransferRun:
        return TransferRun(to=robot.address, token=self._token, by=self._by, rate=self._rate(robot))

    def open(self, feed: Feed) -> Iterable[bytes]:
        """The bytes of a step's feed. Of an upload batch these are the bytes that the robot asks for."""
        if isinstance(feed, UploadBatch):
            return UploadServer(
                feed, open_blob=self._cache.open, limiter=self._limiter, on_end=self._rates.note
            )
        if isinstance(feed, Pull) and feed.registry:
            self._registries.push(feed.registry, feed.images)
            login = self._registries.docker_config(feed.registry, feed.images)
            return PullFeed(feed.images, address=feed.registry.host, login=login)
        if isinstance(feed, Pull):
            return PullServer(feed.images, open_blob=self._cache.open, limiter=self._limiter)
        if isinstance(feed, ImageArchive):
            return self._archive(feed.image, feed.reference)
        raise TypeError(f"{feed.label} needs no sender")

    def _rebuilt(
        self, images: Sequence[Image], packed: Mapping[str, Blob], facts: Facts, *, rate: float | None
    ) -> dict[str, RebuiltLayer]:
        """The layers that the robot rebuilds from layers that it has, because that is faster than uploading them."""
        if not delivery.can_rebuild(facts):
            return {}
        sources = rebuild_command.sources(
            [image.layers for image in images],
            packed,
            chains=facts.fleet.image_store.chains,
            manifests=facts.fleet.image_store.manifests,
            containerd=facts.docker.containerd,
            root=facts.docker.data_root,
        )
        layers = (
            self._rebuilt_layer(packed[wanted], source, rate=rate) for wanted, source in sources.items()
        )
        return {layer.diff_id: layer for layer in layers if layer}

    def _rebuilt_layer(self, blob: Blob, source: Source, *, rate: float | None) -> RebuiltLayer | None:
        patch = None
        if source.diff_id != blob.diff_id:
            if not delivery.rebuilding_is_faster(blob, patch=0, rate=rate):
                return None  # even an empty patch would be slower
            if not (patch := self._patches.make(old=source.diff_id, new=blob.diff_id)):
                return None
        if not delivery.rebuilding_is_faster(blob, patch=patch.size if patch else 0, rate=rate):
            return None
        return RebuiltLayer(diff_id=blob.diff_id, size=blob.unpacked, source=source, patch=patch)

    def _rate(self, robot: Robot) -> float | None:
        return lowest(self._rates.of(robot.address), self._limiter.rate)

    def _target(self, image: Image) -> TargetImage:
        config = self._cache.config(image)
        return TargetImage(name=image.shipped_as, fingerprint=image.fingerprint, config=config)
