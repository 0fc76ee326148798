from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.config.registry import Registry
from fleet.errors import NotReady
from fleet.images.layer import Blob
from fleet.plan.step import Pull
from fleet.robot.image_store import ImageStore
from fleet.transfer import load_archive, pull
from fleet.transfer.receive import TransferRun
from tests.support.handmade import Handmade, digest, layer, packed
from tests.support.samples import PI, facts

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.plan.delivery import Delivery
    from fleet.robot.facts import Facts

BASE, OLD, CODE = layer(1), layer(2), layer(3)
TALKER = Handmade(layers=(BASE, CODE), reference="ghcr.io/tim/talker:latest-amd64")
BLOBS = {digest(data): packed(data)[0] for data in (BASE, OLD, CODE)}
RUN = TransferRun(to="10.0.0.1", token="one", by="tim@desktop")  # noqa: S106
THROUGH_SSH = PI.model_copy(update={"transport": "registry"})
FROM_THERE = THROUGH_SSH.model_copy(update={"registry": Registry(address="reg.local:5000/robots")})


def planned(seen: Facts, *, robot: Robot = THROUGH_SSH) -> tuple[Delivery, Pull]:
    wanted = pull.needed(TALKER.image, seen, robot=robot)
    delivery = pull.plan(
        [(TALKER.image, TALKER.wanted)],
        packed={diff_id: BLOBS[diff_id] for diff_id in wanted},
        robot=robot,
        facts=seen,
        run=RUN,
    )
    feed = delivery.steps[0].feed
    assert isinstance(feed, Pull)
    return delivery, feed


def seen(*, pulled: tuple[bytes, ...] = (), chains: tuple[tuple[bytes, ...], ...] = ()) -> Facts:
    """A robot with a classic store."""
    store = ImageStore(
        chains=tuple(tuple(map(digest, chain)) for chain in chains),
        pulled=frozenset(BLOBS[digest(data)].digest for data in pulled),
    )
    return facts(image_store=store)


def size(*layers: bytes) -> int:
    return sum(BLOBS[digest(data)].size for data in layers)


@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        (seen(), size(BASE, CODE)),
        (seen(pulled=(BASE,), chains=((BASE, OLD),)), size(CODE)),
        # What came by `docker load` has no digest by which Docker could find it.
        (seen(chains=((BASE, OLD),)), size(BASE, CODE)),
        # A layer counts only where it is the next of a chain.
        (seen(pulled=(CODE,), chains=((BASE, OLD),)), size(BASE, CODE)),
        (seen(pulled=(BASE,), chains=((OLD, BASE),)), size(BASE, CODE)),
    ],
)
def test_what_a_classic_store_asks_for(robot: Facts, expected: int) -> None:
    """`--dry` says the bytes that Docker will really fetch."""
    delivery, feed = planned(robot)
    assert (feed.bytes, feed.size) == (expected, expected)
    assert delivery.way == "registry through SSH"


def test_a_containerd_store_finds_layers_however_they_came() -> None:
    """By the blobs of its receipts: the manifest names those, so they need not be packed here."""
    there = Blob(diff_id=digest(BASE), digest=digest(b"as it came"), size=7, media_type="x")
    robot = facts(containerd=True, image_store=ImageStore(manifests=((there,),)))
    assert pull.needed(TALKER.image, robot, robot=THROUGH_SSH) == (digest(CODE),)
    _, feed = planned(robot)
    assert feed.bytes == size(CODE)
    assert feed.images[0].blobs == (there, BLOBS[digest(CODE)])


def test_a_registry_has_all_layers_as_they_are_packed_here() -> None:
    """It takes no manifest whose blobs it lacks. A robot that has the same bytes skips them."""
    other, same = (
        facts(containerd=True, image_store=ImageStore(manifests=((blob,),)))
        for blob in (
            Blob(diff_id=digest(BASE), digest=digest(b"as it came"), size=7, media_type="x"),
            BLOBS[digest(BASE)],
        )
    )
    for robot, lacks in ((other, size(BASE, CODE)), (same, size(CODE))):
        assert len(pull.needed(TALKER.image, robot, robot=FROM_THERE)) == 2
        _, feed = planned(robot, robot=FROM_THERE)
        assert feed.bytes == lacks
        assert feed.images[0].blobs == (BLOBS[digest(BASE)], BLOBS[digest(CODE)])


def test_the_manifest_is_that_of_an_upload() -> None:
    """So an image has one ID, whichever way it came."""
    _, feed = planned(seen())
    skeleton = load_archive.skeleton([TALKER.wanted], blobs=BLOBS, sent=())
    (one,) = feed.images
    assert (one.identity, one.digest) == skeleton.manifests[0].ids
    assert one.path == "tim/talker"
    assert one.tag == f"fleet-{TALKER.image.fingerprint}-{one.digest[7:19]}"


def test_from_a_registry_nothing_comes_through_ssh() -> None:
    """The step names path and digest; the address and the login are on standard input."""
    delivery, feed = planned(seen(), robot=FROM_THERE)
    (one,) = feed.images
    assert (feed.size, feed.bytes, one.path) == (0, size(BASE, CODE), "robots/tim/talker")
    assert delivery.steps[0].argv[-5:] == (
        *(one.path, one.digest, TALKER.image.fingerprint, one.name, one.identity),
    )
    assert (delivery.way, delivery.steps[0].resumes) == ("registry reg.local:5000", True)
    pushed = pull.after_push(delivery, [BLOBS[digest(CODE)]])
    assert "this computer first pushes" in pushed.forecast
    assert pull.after_push(delivery, []) == delivery


def test_an_image_of_another_platform_is_asked_for_by_it() -> None:
    """Docker would look for the platform of the robot itself; an emulated one has to be said."""
    own, emulated = (
        planned(seen(), robot=THROUGH_SSH.model_copy(update={"platform": platform}))[0].steps[0].argv[8]
        for platform in ("linux/arm64", "linux/amd64")
    )
    assert (own, emulated) == ("", "linux/amd64")


def test_a_disk_that_is_too_small_is_refused() -> None:
    """Docker would find out when half of it is there."""
    with pytest.raises(NotReady, match="free disk"):
        planned(facts(free=1000))
