from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.errors import NotReady
from fleet.images.layer import Blob
from fleet.plan.delivery import Delivery
from fleet.plan.step import ImageArchive, Step, UploadBatch
from fleet.robot.image_store import ImageStore
from fleet.transfer import delivery, load_archive, receive
from fleet.transfer.delivery import STRATEGIES
from fleet.transfer.missing import MissingLayers
from fleet.transfer.receive import TransferRun
from tests.support.handmade import Handmade, layer, packed
from tests.support.samples import change, facts

if TYPE_CHECKING:
    from fleet.robot.facts import Facts, Sudo
    from fleet.transfer.delivery import Strategy

BASE, CODE = layer(1), layer(2)
TALKER = Handmade(layers=(BASE, CODE))
BLOBS = {blob.diff_id: blob for blob, _ in map(packed, (BASE, CODE))}
LOW, HIGH = TALKER.diff_ids
RUN = TransferRun(to="pi1.local", token="token", by="tim@desktop")  # noqa: S106  of a run
PROVE = Step(
    title="prove that the image arrived unchanged",
    argv=(
        *("sh", "-c", onboard.text("prove_image.sh"), "prove_image"),
        *(TALKER.image.shipped_as, TALKER.image.identity, TALKER.image.fingerprint),
    ),
    harmless=True,
    resumes=True,
    cure="run the same command again",
)


def robot(
    *,
    containerd: bool = False,
    docker: str = "28.0.4",
    disk_free: int = 20_000_000_000,
    memory: int = 0,
    stock: ImageStore = ImageStore(),  # noqa: B008  frozen
) -> Facts:
    return facts(
        disk_free=disk_free,
        memory=memory,
        containerd=containerd,
        docker_version=docker,
        image_store=stock,
    )


def delivered(
    seen: Facts,
    *,
    send: tuple[str, ...] = (LOW, HIGH),
    rate: float | None = None,
    unpacked: int = 0,
    size: int = 0,
) -> Delivery:
    """Layers of these sizes, or of their own; what is not sent is there."""
    blobs = {
        name: replace(blob, unpacked=unpacked or blob.unpacked, size=size or blob.size)
        for name, blob in BLOBS.items()
    }
    return delivery.layers(
        [(TALKER.image, TALKER.wanted)],
        missing=MissingLayers(send=send, there={}, layers=2),
        packed={name: blobs[name] for name in send},
        rebuilt={},
        facts=seen,
        run=replace(RUN, rate=rate),
    )


def batch(delivered_: Delivery) -> UploadBatch:
    feed = delivered_.steps[0].feed
    assert isinstance(feed, UploadBatch)
    return feed


@pytest.mark.parametrize(
    ("docker", "memory", "encoding"),
    [
        ("20.10.24+dfsg1", 4_000_000_000, "gzip"),
        ("22.06.0-beta", 4_000_000_000, "gzip"),
        ("23.0.0", 4_000_000_000, "zstd-long"),
        ("28.0.4", 4_000_000_000, "zstd-long"),
        ("100.0", 4_000_000_000, "zstd-long"),
        ("28.0.4", 1_199_999_999, "zstd"),
        ("28.0.4", 1_200_000_000, "zstd-long"),
        ("28.0.4", 1, "zstd"),
        ("28.0.4", 0, "zstd-long"),
        ("20.10.24", 1, "gzip"),
        ("", 0, "gzip"),
        ("library-import", 0, "gzip"),
    ],
)
def test_how_layers_are_packed_for_a_robot(docker: str, memory: int, encoding: str) -> None:
    """What its engine reads, and what its memory holds while it unpacks; an unknown engine gets what all can read."""
    assert delivery.encoding(robot(docker=docker, memory=memory)) == encoding


@pytest.mark.parametrize("containerd", [False, True])
@pytest.mark.parametrize(
    ("strategy", "sends"),
    [
        ("patches", (HIGH,)),
        ("missing layers", (HIGH,)),
        ("all layers", (LOW, HIGH)),
        ("plain stream", (LOW, HIGH)),
    ],
)
def test_the_layers_that_each_strategy_sends(
    strategy: Strategy, sends: tuple[str, ...], containerd: bool
) -> None:
    """At first the robot's list of layers is used; if that fails, it is ignored."""
    seen = robot(containerd=containerd, stock=ImageStore(chains=((LOW,),), manifests=((BLOBS[LOW],),)))
    missing = delivery.missing([TALKER.image], seen, strategy=strategy)
    assert missing.send == sends
    assert missing.there == ({LOW: BLOBS[LOW]} if containerd and sends == (HIGH,) else {})


def test_the_ladder() -> None:
    """Each strategy needs less of the robot than the one before."""
    assert STRATEGIES == ("patches", "missing layers", "all layers", "plain stream")


def test_the_layers_of_an_image() -> None:
    """The skeleton and each layer are uploads of one batch; then the image is proved under its name."""
    delivered_ = delivered(robot())
    skeleton = load_archive.skeleton([TALKER.wanted], blobs=BLOBS, sent=[BLOBS[LOW], BLOBS[HIGH]])
    first, *others = batch(delivered_).pieces
    assert (first.data, first.digest, first.size) == (skeleton.data, skeleton.hex, len(skeleton.data))
    assert [(upload.digest, upload.size, upload.data) for upload in others] == [
        (BLOBS[one].hex, BLOBS[one].size, None) for one in (LOW, HIGH)
    ]
    assert delivered_.steps == (
        receive.step(
            batch(delivered_),
            skeleton,
            [BLOBS[LOW], BLOBS[HIGH]],
            {},
            title="send 2 of 2 layers",
            run=RUN,
        ),
        PROVE,
    )
    assert (batch(delivered_).to, batch(delivered_).label) == ("pi1.local", "2 of 2 layers")


def test_layers_that_are_there_are_named_by_what_the_robot_knows() -> None:
    """On containerd's store by the blob of its recorded manifest, which is not sent."""
    known = replace(BLOBS[LOW], digest=f"sha256:{'e' * 64}")
    delivered_ = delivery.layers(
        [(TALKER.image, TALKER.wanted)],
        missing=MissingLayers(send=(HIGH,), there={LOW: known}, layers=2),
        packed={HIGH: BLOBS[HIGH]},
        facts=robot(containerd=True),
        rebuilt={},
        run=RUN,
    )
    skeleton = load_archive.skeleton(
        [TALKER.wanted], blobs={LOW: known, HIGH: BLOBS[HIGH]}, sent=[BLOBS[HIGH]]
    )
    assert [upload.digest for upload in batch(delivered_).pieces] == [skeleton.hex, BLOBS[HIGH].hex]


@pytest.mark.parametrize(
    ("send", "rate", "says"),
    [
        ((LOW, HIGH), None, "lacks 2 of 2 layers, 87 kB packed; "),
        ((HIGH,), None, "lacks 1 of 2 layers, 46 kB packed; "),
        ((), None, "lacks 0 of 2 layers, 5.6 kB packed; "),
        ((LOW, HIGH), 1000.0, "lacks 2 of 2 layers, 87 kB packed, about 87 s at 1.0 kB/s; "),
    ],
)
def test_the_forecast(send: tuple[str, ...], rate: float | None, says: str) -> None:
    """What is there, what is sent, how long that takes where the link is known, and what the disk will be like."""
    assert delivered(robot(), send=send, rate=rate).forecast.startswith(says)


@pytest.mark.parametrize(
    ("containerd", "afterwards"), [(False, "9.8 GB afterwards"), (True, "9.6 GB afterwards")]
)
def test_the_forecast_of_the_disk(containerd: bool, afterwards: str) -> None:
    """A containerd store keeps the packed layers beside the others."""
    delivered_ = delivered(
        robot(containerd=containerd, disk_free=10**10), unpacked=100_000_000, size=100_000_000
    )
    assert delivered_.forecast.endswith(f"; disk: 10.0 GB free, {afterwards}")


@pytest.mark.parametrize(
    ("spooled", "there", "earlier"),
    [
        (0, 0, ""),
        (30_000, 30_000, " (30 kB sent earlier)"),
        (BLOBS[LOW].size, BLOBS[LOW].size, f" ({BLOBS[LOW].size / 1000:.0f} kB sent earlier)"),
        (10**9, BLOBS[LOW].size, f" ({BLOBS[LOW].size / 1000:.0f} kB sent earlier)"),
    ],
)
def test_what_has_arrived_already_is_not_counted(spooled: int, there: int, earlier: str) -> None:
    """The robot's spool holds it, and no more than all of it."""
    delivered_ = delivered(robot(stock=ImageStore(spool={BLOBS[LOW].hex: spooled})))
    assert [upload.there for upload in batch(delivered_).pieces] == [0, there, 0]
    assert batch(delivered_).size == batch(delivered(robot())).size - there
    assert f"{earlier}; disk" in delivered_.forecast
    assert bool(earlier) == ("earlier" in delivered_.forecast)


def test_room_is_needed_for_the_spool_dockers_copy_and_the_layers() -> None:
    """To the byte; what has arrived lies on the disk already."""
    size = batch(delivered(robot())).size
    packed_ = sum(blob.size for blob in BLOBS.values())
    needed = size + packed_ + 1.05 * sum(blob.unpacked for blob in BLOBS.values())
    assert delivered(robot(disk_free=int(needed) + 1)).steps
    with pytest.raises(NotReady) as caught:
        delivered(robot(disk_free=int(needed) - 1))
    assert (
        caught.value.what == f"it needs {needed / 1000:.0f} kB of free disk, and has {needed / 1000:.0f} kB"
    )
    assert caught.value.cure == (
        "`fab prune` removes old releases; `docker system df` on the robot shows what Docker uses"
    )
    assert delivered(
        robot(disk_free=int(needed) - 30_000, stock=ImageStore(spool={BLOBS[LOW].hex: 30_001}))
    ).steps


def test_whole_images_as_a_stream() -> None:
    """The strategy that always works: each image is loaded under its name and proved."""
    delivered_ = delivery.stream([TALKER.image], facts=robot())
    load = Step(
        title=f"load {TALKER.image.shipped_as}",
        argv=("docker", "load", "--quiet"),
        feed=ImageArchive(
            image="talker:latest-amd64", reference=TALKER.image.shipped_as, size=TALKER.image.size
        ),
        limit=None,
        harmless=True,
        resumes=True,
    )
    assert delivered_ == Delivery(
        steps=(load, PROVE), forecast="sends 102 kB, whole images", transfer="whole images"
    )


def test_a_home_on_a_small_disk_of_its_own_must_hold_the_upload() -> None:
    """The upload is gathered there, so Docker's disk needs that much less."""
    size = batch(delivered(robot())).size
    assert delivered(change(robot(), shared=False, home_free=size)).steps
    with pytest.raises(NotReady, match=r"its home directory needs .* of free disk for the upload"):
        delivered(change(robot(), shared=False, home_free=size - 1))


def test_room_for_whole_images() -> None:
    """Docker's copy of the archive, and the layers."""
    needed = round(2.1 * TALKER.image.size)
    assert delivery.stream([TALKER.image], facts=robot(disk_free=needed + 1)).steps
    with pytest.raises(NotReady) as caught:
        delivery.stream([TALKER.image], facts=robot(disk_free=needed - 1))
    assert (
        caught.value.what == f"it needs {needed / 1000:.0f} kB of free disk, and has {needed / 1000:.0f} kB"
    )


def test_a_layer_under_two_diff_ids_is_one_upload() -> None:
    """Uploads are named by their digest, and the robot asks for each once."""
    same = Blob(
        diff_id=HIGH, digest=BLOBS[LOW].digest, size=BLOBS[LOW].size, media_type=BLOBS[LOW].media_type
    )
    delivered_ = delivery.layers(
        [(TALKER.image, TALKER.wanted)],
        missing=MissingLayers(send=(LOW, HIGH), there={}, layers=2),
        packed={LOW: BLOBS[LOW], HIGH: same},
        facts=robot(),
        rebuilt={},
        run=RUN,
    )
    assert len(batch(delivered_).pieces) == 2


@pytest.mark.parametrize(
    ("zstd", "python", "sudo", "can"),
    [
        (True, True, "root", True),
        (True, True, "free", True),
        (True, True, "password", False),
        (True, True, "none", False),
        (False, True, "root", False),
        (True, False, "root", False),
    ],
)
def test_who_can_make_a_layer_of_another_one(zstd: bool, python: bool, sudo: Sudo, can: bool) -> None:
    """It takes both programs, and root without being asked."""
    assert delivery.can_rebuild(change(robot(stock=ImageStore(zstd=zstd, python=python)), sudo=sudo)) == can


@pytest.mark.parametrize(
    ("size", "patch", "rate", "saved"),
    [
        (5_100_000, 0, 1e6, True),
        (4_900_000, 0, 1e6, False),
        (6_000_000, 1_100_000, 1e6, False),
        (6_000_000, 900_000, 1e6, True),
        (5_100_000, 0, 2e6, False),
        (12_600_000, 0, None, True),
        (12_400_000, 0, None, False),
    ],
)
def test_when_rebuilding_is_faster(size: int, patch: int, rate: float | None, saved: bool) -> None:
    """Two seconds, and one for each 15 MB that are rebuilt, against what need not be sent; an unknown link is a fair Wi-Fi."""
    blob = replace(BLOBS[LOW], size=size, unpacked=45_000_000)
    assert delivery.rebuilding_is_faster(blob, patch=patch, rate=rate) == saved
