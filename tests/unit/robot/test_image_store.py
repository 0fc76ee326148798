from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.images.layer import Blob
from fleet.robot.image_store import ImageStore, parse

SECTIONS = ("layers", "sizes", "receipts", "spool", "pins", "tools")
ONE, OTHER = "1" * 64, "2" * 64
GZIP = "application/vnd.oci.image.layer.v1.tar+gzip"


def manifest(*digests: str) -> str:
    layers = [{"mediaType": GZIP, "digest": digest, "size": 7} for digest in digests]
    return json.dumps({"schemaVersion": 2, "layers": layers})


def blob(diff_id: str, digest: str) -> Blob:
    return Blob(diff_id=diff_id, digest=digest, size=7, media_type=GZIP)


def test_a_robot_that_says_nothing_holds_nothing() -> None:
    """Then everything is sent."""
    assert parse({}) == parse(dict.fromkeys(SECTIONS, "")) == ImageStore()


@pytest.mark.parametrize(
    ("said", "chains"),
    [
        ('sha256:1 ["a","b"]', (("a", "b"),)),
        ('sha256:1 ["a","b"]\nsha256:2 ["a"]', (("a", "b"), ("a",))),
        ('sha256:1 ["a"]\nsha256:2 ["a"]', (("a",),)),
        ("sha256:1 null\nsha256:2 []", ()),
        ('sha256:1\n\nsha256:2 ["a"', ()),
        ('sha256:1 {"a": 1}\nsha256:2 ["b"]', (("b",),)),
        ('WARNING: something\nsha256:2 ["b"]', (("b",),)),
        ('sha256:1 [["a"]]\nsha256:2 ["b", 5]\nsha256:3 ["../b"]\nsha256:4 ["a b"]', ()),
    ],
)
def test_the_layers_of_each_image(said: str, chains: tuple[tuple[str, ...], ...]) -> None:
    """In their order, each chain once; images without layers and lines that are none are passed over."""
    assert parse({"layers": said}).chains == chains


@pytest.mark.parametrize(
    ("receipts", "manifests"),
    [
        (f"{ONE} {manifest('x', 'y')}", ((blob("a", "x"), blob("b", "y")),)),
        (f"{OTHER} {manifest('x')}\n{ONE} {manifest('x', 'y')}", ((blob("a", "x"), blob("b", "y")),)),
        (f"{OTHER} {manifest('x', 'y')}", ()),
        (f"{ONE} {manifest('x')}", ()),
        (f"{ONE} {manifest('x', 'y', 'z')}", ()),
        (f"{ONE} {manifest('x', 'y')[:-1]}", ()),
        (f"{ONE} []", ()),
        (f"{ONE} {{}}", ()),
        (f'{ONE} {{"layers": 2}}', ()),
        (f'{ONE} {{"layers": ["x", "y"]}}', ()),
        (f'{ONE} {{"layers": [{{}}, {{}}]}}', ()),
        (ONE, ()),
        (f" {manifest('x', 'y')}", ()),
    ],
)
def test_a_receipt_counts_for_the_image_whose_id_is_its_digest(
    receipts: str, manifests: tuple[tuple[Blob, ...], ...]
) -> None:
    """Of an image that is gone, or of another number of layers, it says nothing; nor does one that was cut."""
    layers = f'sha256:{ONE} ["a","b"]'
    assert parse({"layers": layers, "receipts": receipts}).manifests == manifests


@pytest.mark.parametrize(
    "size", ["1e999", '"many"', "null", "[1]", "-1", "true", "1.5", "9" * 400, "9" * 5000]
)
def test_a_receipt_whose_sizes_are_none_is_passed_over(size: str) -> None:
    """Infinity is a number to JSON."""
    layer = f'{{"mediaType": "{GZIP}", "digest": "x", "size": {size}}}'
    said = {"layers": f'sha256:{ONE} ["a"]', "receipts": f'{ONE} {{"layers": [{layer}]}}'}
    assert parse(said).manifests == ()


@pytest.mark.parametrize("key", ["digest", "mediaType"])
@pytest.mark.parametrize("value", ["5", "null", '["x"]', '""', '"../x"', '"a b"', '"\\ud800"'])
def test_a_receipt_whose_words_are_none_is_passed_over(key: str, value: str) -> None:
    """What travels into the next manifest is text."""
    layer = {"mediaType": f'"{GZIP}"', "digest": '"x"', "size": "7", key: value}
    text = ", ".join(f'"{name}": {said}' for name, said in layer.items())
    said = {"layers": f'sha256:{ONE} ["a"]', "receipts": f'{ONE} {{"layers": [{{{text}}}]}}'}
    assert parse(said).manifests == ()


@pytest.mark.parametrize(
    ("said", "spool"),
    [
        (f"{ONE} 5", {ONE: 5}),
        (f"{ONE} 5\n{OTHER} 0\nholder 12\nlock 0", {ONE: 5, OTHER: 0}),
        (f"{ONE}\n{ONE} -5\n{ONE} 5 6\n{ONE[1:]} 5\n{ONE}0 5\n{'g' * 64} 5", {}),
        (f"{ONE} {'9' * 5000}", {}),
    ],
)
def test_the_pieces_that_have_arrived(said: str, spool: dict[str, int]) -> None:
    """Their digest and size; the lock and who holds it are no pieces."""
    assert parse({"spool": said}).spool == spool


@pytest.mark.parametrize(
    ("said", "pins"),
    [
        (
            (
                '/home/pi/.fleet/stacks/nav/releases/abc/compose.yaml:      "image": "talker:fleet-1",\n'
                '/home/pi/.fleet/stacks/nav/releases/abc/compose.yaml:      "image": "me:5000/camera:fleet-2"\n'
                '/home/pi/.fleet/stacks/cam/releases/abc/compose.yaml:"image": "talker:fleet-1"'
            ),
            {"nav/abc": ("talker:fleet-1", "me:5000/camera:fleet-2"), "cam/abc": ("talker:fleet-1",)},
        ),
        (
            '/home/pi/.fleet/releases/old/compose.override.yaml:      "image": "talker:fleet-0",',
            {"/old": ("talker:fleet-0",)},
        ),
        (
            '/home/pi/.fleet/stacks/nav/releases/old/compose.override.yaml: "image": "talker:fleet-0",',
            {"nav/old": ("talker:fleet-0",)},
        ),
        ('/home/pi/.fleet/stacks/nav/abc/compose.yaml:  "image": "talker"', {}),
        ('releases/abc/compose.yaml: "image": "talker"', {}),
        ('/home/pi/.fleet/stacks/nav/releases/abc/compose.yaml: image: "talker"', {}),
        ('/home/pi/.fleet/stacks/nav/releases/abc/compose.yaml: "image": ""', {}),
    ],
)
def test_which_images_a_release_runs(said: str, pins: dict[str, tuple[str, ...]]) -> None:
    """Every service's, by stack and release; those of the first version of fleet have no stack, or an override."""
    assert parse({"pins": said}).pins == pins


@pytest.mark.parametrize(
    ("said", "zstd", "python"),
    [
        ("/usr/bin/zstd\n/usr/bin/python3", True, True),
        ("/usr/bin/zstd", True, False),
        ("/opt/my/python3", False, True),
        ("/usr/bin/zstdcat\n/usr/bin/python3.11", False, False),
    ],
)
def test_the_tools_it_has(said: str, zstd: bool, python: bool) -> None:
    """By their names, wherever they are."""
    seen = parse({"tools": said})
    assert (seen.zstd, seen.python) == (zstd, python)


@given(said=st.dictionaries(st.sampled_from(SECTIONS), st.text(max_size=200)))
def test_garbage_is_no_traceback(said: dict[str, str]) -> None:
    """Whatever a robot says in whichever section."""
    assert isinstance(parse(said), ImageStore)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["layers", "digest", "size", "mediaType"]) | st.text(max_size=3), inner
        )
    ),
    max_leaves=8,
)
LAYER = st.fixed_dictionaries({"digest": JSON, "size": JSON, "mediaType": JSON})


@given(listing=JSON | st.lists(st.text(max_size=3), max_size=2), receipt=JSON)
def test_json_of_another_shape_is_no_traceback(listing: object, receipt: object) -> None:
    """It is JSON all the same, and so gets further than garbage does."""
    said = {"layers": f"sha256:{ONE} {json.dumps(listing)}", "receipts": f"{ONE} {json.dumps(receipt)}"}
    assert isinstance(parse(said), ImageStore)


@given(layers=st.lists(LAYER, max_size=2))
def test_blobs_of_a_receipt_are_what_they_say_they_are(layers: list[object]) -> None:
    """Text and numbers, or there are none."""
    diff_ids = ["a", "b"][: len(layers)]
    said = {
        "layers": f"sha256:{ONE} {json.dumps(diff_ids)}",
        "receipts": f"{ONE} {json.dumps({'layers': layers})}",
    }
    for blobs in parse(said).manifests:
        assert [one.diff_id for one in blobs] == diff_ids
        assert {type(one.digest) for one in blobs} == {type(one.media_type) for one in blobs} == {str}
        assert {type(one.size) for one in blobs} == {int}


@pytest.mark.parametrize("deep", ["[" * 100_000, '{"layers":' * 100_000])
def test_json_without_bottom_is_no_traceback(deep: str) -> None:
    """Python counts how deep it reads."""
    said = {"layers": f'sha256:{OTHER} {deep}\nsha256:{ONE} ["a"]', "receipts": f"{ONE} {deep}"}
    assert parse(said) == ImageStore(chains=(("a",),))


@pytest.mark.parametrize(
    ("said", "size"),
    [
        ("t:fleet-1 241MB", 241_000_000),
        ("t:fleet-1 2.33kB", 2330),
        ("t:fleet-1 1.1GB", 1_100_000_000),
        ("t:fleet-1 12B", 12),
        ("t:fleet-1 N/A", None),
        ("t:fleet-1 1.2.3MB", 0),
        ("garbage", None),
    ],
)
def test_the_size_of_an_image(said: str, size: int | None) -> None:
    """In the units in which `docker image ls` says it."""
    assert parse({"sizes": said}).sizes.get("t:fleet-1") == size


def test_blobs_that_came_by_a_pull_are_known_as_long_as_their_image_is_there() -> None:
    """Docker finds their layers by these digests; what an odd robot says counts for nothing."""
    described = {**json.loads(manifest("x", "y")), "config": {"digest": f"sha256:{ONE}"}}
    here = {"layers": f'sha256:{ONE} ["a", "b"]'}
    assert parse({**here, "pulled": json.dumps(described)}).pulled == {"x", "y"}
    gone = {"layers": f'sha256:{OTHER} ["a", "b"]'}
    assert parse({**gone, "pulled": json.dumps(described)}).pulled == frozenset()
    for odd in ("", "[]", "{}", "x", '{"config": 5, "layers": []}', "[" * 100_000):
        assert parse({**here, "pulled": odd}).pulled == frozenset()


def test_the_files_of_registries() -> None:
    """As `sha256sum` prints them; nothing outside of that folder."""
    lines = f"{ONE}  /etc/docker/certs.d/r:5000/ca.crt\n{OTHER} */etc/docker/certs.d/r:5000/a b\n{ONE}  /etc/passwd\nx"
    assert parse({"certs": lines}).certs == {
        "/etc/docker/certs.d/r:5000/ca.crt": ONE,
        "/etc/docker/certs.d/r:5000/a b": OTHER,
    }
