"""How do images get from this computer's Docker to many robots? What is common is prepared once and sent to each."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
from typing import TYPE_CHECKING, Self

from fleet.plan import Parcel
from fleet.transfer import delivery, remaking
from fleet.transfer.archive import Wanted
from fleet.transfer.cache import Cache, folder
from fleet.transfer.courier import Courier
from fleet.transfer.delivery import Delivery
from fleet.transfer.patches import Patches
from fleet.transfer.receive import Shipment
from fleet.transfer.remaking import Remade

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
    from pathlib import Path

    from fleet.facts import Facts
    from fleet.image import Image, Store
    from fleet.inventory import Robot
    from fleet.plan import Feed
    from fleet.transfer.delivery import Way
    from fleet.transfer.pace import Pace
    from fleet.transfer.pieces import Blob
    from fleet.transfer.remaking import Source

TELLING = 500_000
"""Bytes from which on a transfer tells something of the link."""


class Sender:
    """One run's shipments. ``open_feed`` gives the bytes of what is no parcel; ``rates`` is a file, and may be removed."""

    def __init__(
        self,
        *,
        cache: Cache,
        pace: Pace,
        by: str,
        rates: Path,
        open_feed: Callable[[Feed], Iterable[bytes]],
    ) -> None:
        self._cache = cache
        self._patches = Patches(cache)
        self._pace = pace
        self._by = by
        self._rates = Rates(rates)
        self._open = open_feed
        self._token = secrets.token_hex(8)

    @classmethod
    @contextlib.contextmanager
    def using(cls, store: Store, *, pace: Pace, by: str) -> Generator[Self]:
        """A sender of this computer's images; its cache is tidied at the end."""
        directory = folder()
        cache = Cache(directory=directory, export=store.export)
        rates = directory.parent / "rates.json"
        try:
            yield cls(cache=cache, pace=pace, by=by, rates=rates, open_feed=store.open)
        finally:
            cache.tidy()

    def deliver(self, images: Sequence[Image], *, robot: Robot, facts: Facts, way: Way) -> Delivery:
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
            shipment=Shipment(to=robot.address, token=self._token, by=self._by, rate=rate),
        )

    def open(self, feed: Feed) -> Iterable[bytes]:
        """The bytes of a step's feed; a parcel's are those that the robot asks for."""
        if isinstance(feed, Parcel):
            return Courier(feed, open_piece=self._cache.open, pace=self._pace, ended=self._rates.note)
        return self._open(feed)

    def _made(
        self, images: Sequence[Image], packed: Mapping[str, Blob], facts: Facts, *, rate: float | None
    ) -> dict[str, Remade]:
        """Those of the packed layers that are there sooner when the robot makes them of what it has."""
        if not delivery.may_make(facts):
            return {}
        found = remaking.sources(
            [image.layers for image in images],
            packed,
            chains=facts.stock.chains,
            manifests=facts.stock.manifests,
            containerd=facts.containerd,
            root=facts.data_root,
        )
        made = (self._remade(packed[wanted], source, rate=rate) for wanted, source in found.items())
        return {one.diff_id: one for one in made if one}

    def _remade(self, blob: Blob, source: Source, *, rate: float | None) -> Remade | None:
        patch = None
        if source.diff_id != blob.diff_id:
            if not delivery.saves(blob, patch=0, rate=rate):
                return None  # no patch is small enough
            if not (patch := self._patches.make(old=source.diff_id, new=blob.diff_id)):
                return None
        if not delivery.saves(blob, patch=patch.size if patch else 0, rate=rate):
            return None
        return Remade(diff_id=blob.diff_id, size=blob.unpacked, source=source, patch=patch)

    def _rate(self, robot: Robot) -> float | None:
        return _least(self._rates.of(robot.address), self._pace.rate)

    def _wanted(self, image: Image) -> Wanted:
        config = self._cache.config(image)
        return Wanted(name=image.shipped_as, fingerprint=image.fingerprint, config=config)


class Rates:
    """How fast each robot's link was when bytes flowed last, in bytes per second, kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def of(self, address: str) -> float | None:
        """The last known rate to an address."""
        return self._read().get(address)

    def note(self, address: str, count: int, seconds: float) -> None:
        """Remember a transfer that tells something."""
        if count >= TELLING and seconds > 0:
            with contextlib.suppress(OSError):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                rates = {**self._read(), address: round(count / seconds)}
                part = self._path.with_suffix(f".{os.getpid()}")
                part.write_text(json.dumps(rates), encoding="utf-8")
                part.replace(self._path)

    def _read(self) -> dict[str, float]:
        try:
            said = json.loads(self._path.read_text(encoding="utf-8"))
            return {str(name): float(rate) for name, rate in said.items()}
        except (OSError, ValueError, AttributeError, TypeError, OverflowError):
            return {}


def _least(*rates: float | None) -> float | None:
    return min((rate for rate in rates if rate), default=None)
