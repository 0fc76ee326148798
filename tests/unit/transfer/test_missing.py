from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.images.layer import Blob
from fleet.transfer.missing import MissingLayers, missing_layers

Layers = tuple[str, ...]

LAYERS = st.lists(st.sampled_from("abcd"), max_size=5).map(tuple)
IMAGES = st.lists(LAYERS, max_size=4)


def blob(diff_id: str, content: str = "") -> Blob:
    return Blob(diff_id=diff_id, digest=f"sha256:{content or diff_id * 2}", size=7, media_type="tar+gzip")


def classic(images: list[Layers], *, chains: list[Layers]) -> Layers:
    """What is sent to a classic store."""
    return missing_layers(images, chains=chains, manifests=(), containerd=False).send


@pytest.mark.parametrize(
    ("images", "there", "send"),
    [
        (["abc"], [], "abc"),
        (["abc"], ["abc"], ""),
        (["abc"], ["abcd"], ""),
        (["abc"], ["ab"], "c"),
        (["abc"], ["axc"], "bc"),
        (["abc"], ["xbc"], "abc"),
        (["abc"], ["bc", "c"], "abc"),
        (["abc"], ["ax", "abx", "a"], "c"),
        (["aba"], ["ab"], "a"),
        (["aba"], ["a"], "ba"),
        (["aab"], ["ab"], "ab"),
        (["aab"], ["aa"], "b"),
        (["aaa"], [], "a"),
        (["abc", "abd"], [], "abcd"),
        (["abc", "abd"], ["abd"], "c"),
        (["ab", "b"], [], "ab"),
        (["ab", "b"], ["ab"], "b"),
        (["abc", "abc"], ["a"], "bc"),
        ([""], ["abc"], ""),
        ([], ["abc"], ""),
    ],
)
def test_a_classic_store_finds_layers_by_their_chain(images: list[str], there: list[str], send: str) -> None:
    """Only a prefix of an image that is there, or earlier in the archive, is left out; above a change all is sent."""
    wanted = [tuple(image) for image in images]
    assert missing_layers(wanted, chains=map(tuple, there), manifests=(), containerd=False) == MissingLayers(
        send=tuple(send), there={}, layers=len(set("".join(images)))
    )


def test_a_classic_store_is_not_asked_for_blobs() -> None:
    """A recorded manifest says what containerd kept; a chain alone counts here, and there is nothing to name a layer by but that."""
    missing = missing_layers(
        [("a", "b")], chains=[("a",)], manifests=[(blob("a"), blob("b"))], containerd=False
    )
    assert missing == MissingLayers(send=("b",), there={}, layers=2)


@pytest.mark.parametrize(
    ("images", "known", "send"),
    [
        (["abc"], [], "abc"),
        (["abc"], ["abc"], ""),
        (["abc"], ["xbc"], "a"),
        (["abc"], ["a", "c"], "b"),
        (["aba"], ["b"], "a"),
        (["abc", "abd"], ["ab"], "cd"),
        (["abc", "dc"], ["d"], "abc"),
        ([], ["a"], ""),
    ],
)
def test_a_containerd_store_finds_blobs_wherever_they_came_from(
    images: list[str], known: list[str], send: str
) -> None:
    """A layer above a changed one is there all the same, if its blob is known."""
    wanted = [tuple(image) for image in images]
    every = set("".join(images))
    assert missing_layers(
        wanted, chains=(), manifests=[[blob(one) for one in layers] for layers in known], containerd=True
    ) == MissingLayers(
        send=tuple(send), there={one: blob(one) for one in every & set("".join(known))}, layers=len(every)
    )


def test_a_containerd_store_is_not_believed_by_diff_id() -> None:
    """It would take any digest, and then hold a broken image: without a recorded manifest the layer is sent."""
    missing = missing_layers([("a", "b")], chains=[("a", "b")], manifests=(), containerd=True)
    assert missing == MissingLayers(send=("a", "b"), there={}, layers=2)


def test_of_two_blobs_of_a_layer_one_is_named() -> None:
    """Packed twice, it was received twice: either will do."""
    twice = [[blob("a", "one")], [blob("a", "other")]]
    missing = missing_layers([("a",)], chains=(), manifests=twice, containerd=True)
    assert missing.send == ()
    assert missing.there["a"] in (blob("a", "one"), blob("a", "other"))


@given(images=IMAGES, there=IMAGES)
def test_a_classic_engine_takes_the_archive(images: list[Layers], there: list[Layers]) -> None:
    """It goes through the images as the engine does: each layer is in the archive, or its chain is known by then."""
    assert takes(images, there=there, sent=classic(images, chains=there))


@given(images=IMAGES, there=IMAGES)
def test_a_classic_engine_takes_no_less(images: list[Layers], there: list[Layers]) -> None:
    """Nothing is sent that could have been left out, and nothing twice."""
    sent = classic(images, chains=there)
    assert len(set(sent)) == len(sent)
    for one in sent:
        assert not takes(images, there=there, sent=tuple(other for other in sent if other != one))


@given(images=IMAGES, there=IMAGES)
def test_what_is_left_out_of_an_image_is_a_prefix_of_another(
    images: list[Layers], there: list[Layers]
) -> None:
    """Of one that is there or comes earlier: however many of its upper layers are somewhere else."""
    sent = classic(images, chains=there)
    for count, image in enumerate(images):
        out = next((n for n, one in enumerate(image) if one in sent), len(image))
        assert any(other[:out] == image[:out] for other in (*there, *images[:count], ()))


@given(images=IMAGES, known=IMAGES)
def test_a_containerd_store_gets_each_layer_in_one_of_two_ways(
    images: list[Layers], known: list[Layers]
) -> None:
    """Each is sent or is there, and none is both."""
    manifests = [[blob(one) for one in layers] for layers in known]
    missing = missing_layers(images, chains=(), manifests=manifests, containerd=True)
    every = {one for image in images for one in image}
    assert {*missing.send, *missing.there} == every
    assert len(missing.send) + len(missing.there) == missing.layers == len(every)


def takes(images: list[Layers], *, there: list[Layers], sent: Layers) -> bool:
    """Whether an engine that looks layers up by chain can load ``images`` from an archive with the layers ``sent``."""
    chains = {chain[:count] for chain in there for count in range(len(chain) + 1)}
    for image in images:
        for count, one in enumerate(image, start=1):
            if image[:count] not in chains and one not in sent:
                return False
            chains.add(image[:count])
    return True


def test_the_digest_without_its_algorithm() -> None:
    """What files are called on a robot."""
    assert blob("a", "f00").hex == "f00"
