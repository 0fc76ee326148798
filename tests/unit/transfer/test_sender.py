from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from fleet.images.store import Store
from fleet.plan.delivery import Delivery
from fleet.plan.step import Bytes, ImageArchive, UploadBatch
from fleet.robot.image_store import ImageStore
from fleet.transfer import delivery
from fleet.transfer.layer_cache import LayerCache
from fleet.transfer.link_rates import ENOUGH_TO_MEASURE, LinkRates
from fleet.transfer.rate_limit import RateLimiter
from fleet.transfer.sender import Sender
from fleet.transfer.upload_server import UploadServer
from tests.support.handmade import Engine, Handmade, digest, layer, packed
from tests.support.samples import PI, change, facts

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

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
            pace=RateLimiter(limit),
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

    def deliver(
        self, *images: Handmade, seen: Facts | None = None, way: Strategy = "missing layers"
    ) -> Delivery:
        wanted = [one.image for one in images]
        return self.sender.deliver(wanted, robot=PI, facts=seen or robot(), way=way)


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def robot(*chains: Sequence[bytes]) -> Facts:
    """A robot that holds images of these layers, and whose engine reads gzip only."""
    stock = ImageStore(chains=tuple(tuple(map(digest, chain)) for chain in chains))
    return change(facts(), docker_version="20.10.24", image_store=stock)


def sent(made: Delivery) -> list[str]:
    """The digests of the layers that are sent: all pieces but the frame."""
    (parcel,) = (step.feed for step in made.steps if isinstance(step.feed, UploadBatch))
    assert parcel.to == PI.address
    return [f"sha256:{piece.digest}" for piece in parcel.pieces[1:]]


def packs(*layers: bytes) -> list[str]:
    return [packed(data)[0].digest for data in layers]


def test_nothing_is_missing(desk: Desk) -> None:
    """Then nothing is done, here or there."""
    assert desk.deliver() == Delivery()
    assert desk.exported == []


@pytest.mark.parametrize(
    ("way", "chains", "layers"),
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
    desk: Desk, way: Strategy, chains: tuple[tuple[bytes, ...], ...], layers: tuple[bytes, ...]
) -> None:
    """The layers that the robot lacks, packed as its engine reads them; or all of them, where it is not believed."""
    assert sent(desk.deliver(TALKER, seen=robot(*chains), way=way)) == packs(*layers)
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
    """The last way is Docker's own from end to end."""
    assert desk.deliver(TALKER, CAMERA, way="plain stream") == delivery.stream(
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
    said = desk.deliver(TALKER).forecast
    assert says in said
    assert bool(says) == ("/s" in said)


def test_a_parcel_is_opened_as_a_courier_that_notes_how_fast_it_went(desk: Desk) -> None:
    """Its pieces come out of the cache; when it is closed, what the link was like is known."""
    (parcel, *_) = (step.feed for step in desk.deliver(TALKER).steps)
    assert isinstance(parcel, UploadBatch)
    courier = desk.sender.open(parcel)
    assert isinstance(courier, UploadServer)
    for piece in parcel.pieces:
        courier.heard(f"need {piece.digest} 0\n".encode())
    courier.heard(b"enough\n")
    assert len(b"".join(courier)) == parcel.size
    courier.sent, courier.seconds = 2_000_000, 2.0
    courier.close()
    assert json.loads(desk.rates.read_text()) == {PI.address: 1_000_000}


def test_whole_images_are_read_out_of_docker(desk: Desk) -> None:
    """That is the last way; what a plan carries itself needs no sender."""
    assert desk.sender.open(ImageArchive(image="talker", reference="talker:fleet-1", size=9)) == [b"opened"]
    assert desk.opened == [("talker", "talker:fleet-1")]
    with pytest.raises(TypeError, match="3 files needs no sender"):
        desk.sender.open(Bytes(label="3 files", data=b"abc"))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "5",
        "null",
        '{"pi": "fast"}',
        '{"pi": null}',
        '{"pi": [1]}',
        "\xff",
        f'{{"pi": {"9" * 400}}}',
    ],
)
def test_a_file_of_rates_that_is_none_is_as_good_as_no_file(tmp_path: Path, text: str) -> None:
    """And is one again after the next transfer."""
    path = tmp_path / "rates.json"
    path.write_text(text, encoding="latin-1")
    rates = LinkRates(path)
    assert rates.of("pi") is None
    rates.note("pi", 2 * ENOUGH_TO_MEASURE, 2.0)
    assert rates.of("pi") == ENOUGH_TO_MEASURE


@pytest.mark.parametrize(
    ("count", "seconds", "rate"),
    [
        (ENOUGH_TO_MEASURE, 1.0, 500_000),
        (ENOUGH_TO_MEASURE - 1, 1.0, None),
        (ENOUGH_TO_MEASURE, 0.0, None),
        (10**9, 3.0, 333_333_333),
    ],
)
def test_a_transfer_that_tells_nothing_is_not_noted(
    tmp_path: Path, count: int, seconds: float, rate: float | None
) -> None:
    """A few bytes fit into the buffers between here and there."""
    rates = LinkRates(tmp_path / "new/rates.json")
    rates.note("pi", count, seconds)
    assert rates.of("pi") == rate


def test_rates_of_other_robots_stay(tmp_path: Path) -> None:
    """One line for each address, also from another run."""
    path = tmp_path / "rates.json"
    LinkRates(path).note("pi1", ENOUGH_TO_MEASURE, 1.0)
    LinkRates(path).note("pi2", ENOUGH_TO_MEASURE, 2.0)
    LinkRates(path).note("pi1", ENOUGH_TO_MEASURE, 4.0)
    assert json.loads(path.read_text()) == {"pi1": 125_000, "pi2": 250_000}


def test_rates_that_cannot_be_written_are_no_failure(tmp_path: Path) -> None:
    """They only serve a forecast."""
    (tmp_path / "file").write_text("in the way")
    rates = LinkRates(tmp_path / "file/rates.json")
    rates.note("pi", ENOUGH_TO_MEASURE, 1.0)
    assert rates.of("pi") is None


@pytest.mark.usefixtures("desktop")
def test_the_images_of_this_computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the engine to the pieces, in the login's cache, which is tidied at the end."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    tidied: list[LayerCache] = []
    monkeypatch.setattr(LayerCache, "tidy", lambda cache, **_: tidied.append(cache))
    engine = Engine()
    image = Handmade(layers=(BASE, CODE), reference=f"{engine.name}:latest-amd64")
    try:
        engine.load(image.saved())
        with Store() as store, Sender.using(store, pace=RateLimiter(None), by="tim@desktop") as sender:
            found = store.find(image.reference, "linux/amd64")
            made = sender.deliver([found], robot=PI, facts=robot(), way="all layers")
            assert sent(made) == packs(BASE, CODE)
            assert tidied == []
    finally:
        engine.clear()
    assert len(tidied) == 1
    assert (tmp_path / "fleet/layers").is_dir()
