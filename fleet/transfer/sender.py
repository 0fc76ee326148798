"""How do images get from this computer's Docker to many robots? What is common is prepared once and sent to each."""

from __future__ import annotations

import contextlib
import secrets
from typing import TYPE_CHECKING, Self

from fleet.plan.delivery import Delivery
from fleet.plan.step import ImageArchive, UploadBatch
from fleet.transfer import delivery, rebuild_command
from fleet.transfer.layer_cache import LayerCache, folder
from fleet.transfer.load_archive import TargetImage
from fleet.transfer.patch_cache import PatchCache
from fleet.transfer.rebuild_command import RebuiltLayer
from fleet.transfer.receive import TransferRun
from fleet.transfer.upload_server import UploadServer

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.images.layer import Blob
    from fleet.images.store import Store
    from fleet.plan.step import Feed
    from fleet.robot.facts import Facts
    from fleet.transfer.delivery import Strategy
    from fleet.transfer.rate_limit import RateLimiter
    from fleet.transfer.rebuild_command import Source
from fleet.transfer.link_rates import LinkRates, lowest


class Sender:
    """One run's shipments. ``archive`` reads an image out of Docker, as `fleet.images.store.Store.archive` does; ``rates`` is a file, and may be removed."""

    def __init__(
        self,
        *,
        cache: LayerCache,
        pace: RateLimiter,
        by: str,
        rates: Path,
        archive: Callable[[str, str], Iterable[bytes]],
    ) -> None:
        self._cache = cache
        self._patches = PatchCache(cache)
        self._pace = pace
        self._by = by
        self._rates = LinkRates(rates)
        self._archive = archive
        self._token = secrets.token_hex(8)

    @classmethod
    @contextlib.contextmanager
    def using(cls, store: Store, *, pace: RateLimiter, by: str) -> Generator[Self]:
        """A sender of this computer's images; its cache is tidied at the end."""
        directory = folder()
        cache = LayerCache(directory=directory, export=store.export)
        rates = directory.parent / "rates.json"
        try:
            yield cls(cache=cache, pace=pace, by=by, rates=rates, archive=store.archive)
        finally:
            cache.tidy()

    def deliver(self, images: Sequence[Image], *, robot: Robot, facts: Facts, way: Strategy) -> Delivery:
        """The steps that bring images to a robot.

        Raises:
            NotReady: they would not fit on its disk.
            DesktopError: this computer's Docker cannot give them.

        """
        if not images:
            return Delivery()
        if way == "plain stream":
            return delivery.stream(images, facts=facts)
        lack = delivery.lack(images, facts, way=way)
        encoding, rate = delivery.encoding(facts), self._rate(robot)
        packed: dict[str, Blob] = {}
        for image in images:
            own = [diff_id for diff_id in image.layers if diff_id in lack.send and diff_id not in packed]
            packed |= self._cache.pack(image, own, encoding) if own else {}
        return delivery.pieces(
            tuple((image, self._wanted(image)) for image in images),
            lack=lack,
            packed=packed,
            made=self._made(images, packed, facts, rate=rate) if way == "patches" else {},
            facts=facts,
            shipment=TransferRun(to=robot.address, token=self._token, by=self._by, rate=rate),
        )

    def open(self, feed: Feed) -> Iterable[bytes]:
        """The bytes of a step's feed; a parcel's are those that the robot asks for."""
        if isinstance(feed, UploadBatch):
            return UploadServer(feed, open_piece=self._cache.open, pace=self._pace, ended=self._rates.note)
        if isinstance(feed, ImageArchive):
            return self._archive(feed.image, feed.reference)
        raise TypeError(f"{feed.label} needs no sender")

    def _made(
        self, images: Sequence[Image], packed: Mapping[str, Blob], facts: Facts, *, rate: float | None
    ) -> dict[str, RebuiltLayer]:
        """Those of the packed layers that are there sooner when the robot makes them of what it has."""
        if not delivery.may_make(facts):
            return {}
        found = rebuild_command.sources(
            [image.layers for image in images],
            packed,
            chains=facts.fleet.image_store.chains,
            manifests=facts.fleet.image_store.manifests,
            containerd=facts.docker.containerd,
            root=facts.docker.data_root,
        )
        made = (self._remade(packed[wanted], source, rate=rate) for wanted, source in found.items())
        return {one.diff_id: one for one in made if one}

    def _remade(self, blob: Blob, source: Source, *, rate: float | None) -> RebuiltLayer | None:
        patch = None
        if source.diff_id != blob.diff_id:
            if not delivery.saves(blob, patch=0, rate=rate):
                return None  # no patch is small enough
            if not (patch := self._patches.make(old=source.diff_id, new=blob.diff_id)):
                return None
        if not delivery.saves(blob, patch=patch.size if patch else 0, rate=rate):
            return None
        return RebuiltLayer(diff_id=blob.diff_id, size=blob.unpacked, source=source, patch=patch)

    def _rate(self, robot: Robot) -> float | None:
        return lowest(self._rates.of(robot.address), self._pace.rate)

    def _wanted(self, image: Image) -> TargetImage:
        config = self._cache.config(image)
        return TargetImage(name=image.shipped_as, fingerprint=image.fingerprint, config=config)
