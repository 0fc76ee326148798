from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.config.registry import Registry
from fleet.errors import NotReady
from fleet.images.store import Store
from fleet.plan.delivery import Delivery
from fleet.plan.step import Bytes, ImageArchive, Pull, UploadBatch
from fleet.robot.image_store import ImageStore
from fleet.transfer import delivery
from fleet.transfer.layer_cache import LayerCache
from fleet.transfer.pull_server import PullFeed, PullServer
from fleet.transfer.rate_limit import RateLimiter
from fleet.transfer.sender import Sender
from fleet.transfer.upload_server import UploadServer
from tests.support.handmade import Engine, Handmade, digest, layer, packed
from tests.support.registry import TestRegistry
from tests.support.samples import PI, change, facts

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.robot.facts import Facts
    from fleet.transfer.delivery import Strategy

BASE, CODE, OTHER = layer(1), layer(2), layer(3)
TALKER = Handmade(layers=(BASE, CODE))
CAMERA = Handmade(layers=(BASE, OTHER), reference="camera:1")


class Desk:
    """A sender, its cache's folder, and what it asked of the engine."""

    def __init__(self, folder: Path, *, limit: float | None = None) -> None:
        self.rates = folder / "rates.json"
        self.exported: list[str] = []
        self.opened: list[tuple[str, str]] = []
        self.sender = Sender(
            cache=LayerCache(directory=folder / "layers", export=self._export),
            limiter=RateLimiter(limit),
            by="tim@desktop",
            rates=self.rates,
            archive=self._open,
        )

    def _export(self, image: Image) -> Iterable[bytes]:
        self.exported.append(image.reference)
        return [next(one for one in (TALKER, CAMERA) if one.image == image).saved()]

    def _open(self, local: str, reference: str) -> Iterable[bytes]:
        self.opened.append((local, reference))
        return [b"opened"]

    def deliver_to(self, to: Robot, *images: Handmade) -> Delivery:
        wanted = [one.image for one in images]
        return self.sender.deliver(wanted, robot=to, facts=robot(), strategy="patches")

    def deliver(
        self, *images: Handmade, seen: Facts | None = None, strategy: Strategy = "missing layers"
    ) -> Delivery:
        wanted = [one.image for one in images]
        return self.sender.deliver(wanted, robot=PI, facts=seen or robot(), strategy=strategy)


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def robot(*chains: Sequence[bytes]) -> Facts:
    """A robot that holds images of these layers, and whose engine reads gzip only."""
    stock = ImageStore(chains=tuple(tuple(map(digest, chain)) for chain in chains))
    return change(facts(), docker_version="20.10.24", image_store=stock)


def sent(delivery: Delivery) -> list[str]:
    """The digests of the layers that are sent: all uploads but the skeleton."""
    (batch,) = (step.feed for step in delivery.steps if isinstance(step.feed, UploadBatch))
    assert batch.to == PI.address
    return [f"sha256:{upload.digest}" for upload in batch.pieces[1:]]


def packs(*layers: bytes) -> list[str]:
    return [packed(data)[0].digest for data in layers]


def test_nothing_is_missing(desk: Desk) -> None:
    """Then nothing is done, here or there."""
    assert desk.deliver() == Delivery()
    assert desk.exported == []


@pytest.mark.parametrize(
    ("strategy", "chains", "layers"),
    [
        ("missing layers", (), (BASE, CODE)),
        ("missing layers", ((BASE,),), (CODE,)),
        ("missing layers", ((BASE, OTHER),), (CODE,)),
        ("missing layers", ((OTHER, CODE),), (BASE, CODE)),
        ("missing layers", ((BASE, CODE),), ()),
        ("all layers", ((BASE, CODE),), (BASE, CODE)),
    ],
)
def test_what_is_sent_of_an_image(
    desk: Desk, strategy: Strategy, chains: tuple[tuple[bytes, ...], ...], layers: tuple[bytes, ...]
) -> None:
    """The layers that the robot lacks, packed as its engine reads them; or all of them, where it is not believed."""
    assert sent(desk.deliver(TALKER, seen=robot(*chains), strategy=strategy)) == packs(*layers)
    assert desk.exported == [TALKER.reference]


def test_layers_that_two_images_share_are_packed_and_sent_once(desk: Desk) -> None:
    """The second is asked only for what the first has not."""
    assert sent(desk.deliver(TALKER, CAMERA)) == packs(BASE, CODE, OTHER)
    assert desk.exported == [TALKER.reference, CAMERA.reference]
    layers = [path for path in (desk.rates.parent / "layers").iterdir() if len(path.name) == 64]
    assert len(layers) == 3


def test_what_robots_have_in_common_is_prepared_once(desk: Desk) -> None:
    """A fleet costs the engine as much as one robot."""
    plans = [desk.deliver(TALKER, seen=robot(*chains)) for chains in ((), ((BASE,),), (), ((BASE,),))]
    assert plans[0] == plans[2] != plans[1] == plans[3]
    assert desk.exported == [TALKER.reference]


def test_a_plain_stream_needs_no_packing(desk: Desk) -> None:
    """The last strategy uses only Docker from end to end."""
    assert desk.deliver(TALKER, CAMERA, strategy="plain stream") == delivery.stream(
        [TALKER.image, CAMERA.image], facts=robot()
    )
    assert desk.exported == []


def test_each_run_has_a_token_of_its_own(tmp_path: Path) -> None:
    """By that a robot tells a run that is back after a cut from another one."""
    one, other = (Desk(tmp_path / name) for name in ("one", "other"))
    tokens = {desk.deliver(TALKER).steps[0].argv[4] for desk in (one, one, other)}
    assert len(tokens) == 2
    assert all(len(token) == 16 for token in tokens)


@pytest.mark.parametrize(
    ("known", "limit", "says"),
    [
        ({}, None, ""),
        ({PI.address: 2000}, None, " at 2.0 kB/s"),
        ({PI.address: 2000}, 1000, " at 1.0 kB/s"),
        ({PI.address: 2000}, 9000, " at 2.0 kB/s"),
        ({}, 1000, " at 1.0 kB/s"),
        ({"other": 2000, PI.address: 0}, None, ""),
    ],
)
def test_the_forecast_knows_the_link(
    tmp_path: Path, known: dict[str, int], limit: float | None, says: str
) -> None:
    """As it was the last time, and not faster than it may be now."""
    desk = Desk(tmp_path, limit=limit)
    desk.rates.write_text(json.dumps(known))
    forecast = desk.deliver(TALKER).forecast
    assert says in forecast
    assert bool(says) == ("/s" in forecast)


def test_a_batch_is_served_and_the_rate_is_recorded(desk: Desk) -> None:
    """The uploads come out of the cache; when the server is closed, the rate of the link is known."""
    (batch, *_) = (step.feed for step in desk.deliver(TALKER).steps)
    assert isinstance(batch, UploadBatch)
    server = desk.sender.open(batch)
    assert isinstance(server, UploadServer)
    for upload in batch.pieces:
        server.on_output(f"need {upload.digest} 0\n".encode())
    server.on_output(b"enough\n")
    assert len(b"".join(server)) == batch.size
    server.sent, server.seconds = 2_000_000, 2.0
    server.close()
    assert json.loads(desk.rates.read_text()) == {PI.address: 1_000_000}


def test_a_robot_may_pull(desk: Desk) -> None:
    """From this computer all layers are packed, and a feed serves them; whatever the strategy."""
    pulls = PI.model_copy(update={"transport": "registry"})
    plan = desk.sender.deliver([TALKER.image], robot=pulls, facts=robot(), strategy="all layers")
    feed = plan.steps[0].feed
    assert isinstance(feed, Pull)
    assert [blob.digest for blob in feed.images[0].blobs] == packs(BASE, CODE)
    assert isinstance(desk.sender.open(feed), PullServer)


def test_a_registry_gets_what_it_lacks_before_a_robot_pulls(desk: Desk) -> None:
    """Planning only asks it; the push is a part of the step. A registry that is down is one robot's failure."""
    with TestRegistry() as there:
        registry = Registry(address=f"127.0.0.1:{there.port}/robots")
        pulls = PI.model_copy(update={"transport": "registry", "registry": registry})
        plan = desk.sender.deliver([TALKER.image], robot=pulls, facts=robot(), strategy="patches")
        assert "this computer first pushes" in plan.forecast
        assert there.blobs == {}
        feed = plan.steps[0].feed
        assert isinstance(feed, Pull)
        opened = desk.sender.open(feed)
        assert isinstance(opened, PullFeed)
        assert (opened.address, isinstance(opened, PullServer)) == (registry.host, False)
        assert set(packs(BASE, CODE)) < set(there.blobs)
    with pytest.raises(NotReady, match="cannot be reached"):
        desk.deliver_to(pulls, CAMERA)


def test_whole_images_are_read_out_of_docker(desk: Desk) -> None:
    """That is the last strategy; bytes that a plan contains need no sender."""
    assert desk.sender.open(ImageArchive(image="talker", reference="talker:fleet-1", size=9)) == [b"opened"]
    assert desk.opened == [("talker", "talker:fleet-1")]
    with pytest.raises(TypeError, match="3 files needs no sender"):
        desk.sender.open(Bytes(label="3 files", data=b"abc"))


@pytest.mark.usefixtures("desktop")
def test_the_images_of_this_computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From Docker to the uploads, in the login's cache, which is tidied at the end."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    tidied: list[LayerCache] = []
    monkeypatch.setattr(LayerCache, "tidy", lambda cache, **_: tidied.append(cache))
    engine = Engine()
    image = Handmade(layers=(BASE, CODE), reference=f"{engine.name}:latest-amd64")
    try:
        engine.load(image.saved())
        with Store() as store, Sender.using(store, limiter=RateLimiter(None), by="tim@desktop") as sender:
            image_here = store.find(image.reference, "linux/amd64")
            delivered = sender.deliver([image_here], robot=PI, facts=robot(), strategy="all layers")
            assert sent(delivered) == packs(BASE, CODE)
            assert tidied == []
    finally:
        engine.clear()
    assert len(tidied) == 1
    assert (tmp_path / "fleet/layers").is_dir()
