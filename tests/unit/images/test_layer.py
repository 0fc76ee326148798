from __future__ import annotations

import hashlib

from hypothesis import given
from hypothesis import strategies as st

from fleet.images.layer import PLAIN, Blob, chain_id, common_prefix

WORDS = st.lists(st.sampled_from("abc"))


def test_a_chain_of_one_layer_is_named_by_it() -> None:
    """The specification's first case (opencontainers/image-spec, config.md, "Layer ChainID")."""
    assert chain_id(["sha256:a"]) == "sha256:a"


def test_a_longer_chain_is_named_by_the_one_below_and_its_top() -> None:
    """The specification's second case; the order of the layers counts."""
    expected = f"sha256:{hashlib.sha256(b'sha256:a sha256:b').hexdigest()}"
    assert chain_id(["sha256:a", "sha256:b"]) == expected
    assert chain_id(["sha256:b", "sha256:a"]) != expected
    assert chain_id(["sha256:a", "sha256:b", "sha256:c"]) == chain_id([expected, "sha256:c"])


@given(common=WORDS, one=WORDS, other=WORDS)
def test_the_common_prefix_of_two_chains(common: list[str], one: list[str], other: list[str]) -> None:
    """As far as both agree, and not one further."""
    first, second = common + one, common + other
    length = common_prefix(first, second)
    assert length >= len(common)
    assert first[:length] == second[:length]
    assert first[length : length + 1] != second[length : length + 1] or not (
        first[length:] and second[length:]
    )


def test_a_layers_tar_as_a_blob() -> None:
    """Nothing is packed: the bytes are the tar."""
    blob = Blob.plain("sha256:ab", 7)
    assert blob == Blob(diff_id="sha256:ab", digest="sha256:ab", size=7, media_type=PLAIN, unpacked=7)
    assert blob.hex == "ab"
