from __future__ import annotations

import contextlib
import gzip
import json
import os
import threading
from typing import TYPE_CHECKING, get_args

import pytest

from fleet.errors import DesktopError
from fleet.images.store import Store
from fleet.transfer import codec, layer_cache
from fleet.transfer.codec import Encoding
from fleet.transfer.layer_cache import LayerCache
from tests.support.handmade import FORMS, MEDIA_TYPES, Engine, Form, Handmade, digest, layer, packed, tar

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

    from fleet.images.image import Image
    from fleet.images.layer import Blob

BASE, CODE = layer(1), layer(2)
TALKER = Handmade(layers=(BASE, CODE))


class Desk:
    """A cache, and an engine that has images in one form and counts how often it is asked."""

    def __init__(self, folder: Path, *images: Handmade, form: Form = "20.10", archive: bytes = b"") -> None:
        self.folder = folder / "layers"
        self.exports = 0
        self._archives = {one.image: archive or one.saved(form) for one in images}
        self.cache = self.another()

    def another(self) -> LayerCache:
        """What another run has: the same files."""
        return LayerCache(directory=self.folder, export=self._export)

    def _export(self, image: Image) -> Iterator[bytes]:
        """In chunks of any size, as the engine gives them."""
        self.exports += 1
        archive = self._archives[image]
        for at in range(0, len(archive), 10_007):
            yield archive[at : at + 10_007]

    def content(self, blob: Blob) -> bytes:
        with self.cache.open(blob.hex) as file:
            return file.read()


@pytest.mark.parametrize("encoding", get_args(Encoding))
@pytest.mark.parametrize("form", FORMS)
def test_the_layers_of_an_archive_are_packed(tmp_path: Path, form: Form, encoding: Encoding) -> None:
    """Whichever engine wrote it, and however it had packed them: the same bytes under the same digest."""
    desk = Desk(tmp_path, TALKER, form=form)
    blobs = desk.cache.pack(TALKER.image, TALKER.diff_ids, encoding)
    assert blobs == {digest(data): packed(data, encoding)[0] for data in (BASE, CODE)}
    for data in (BASE, CODE):
        content = desk.content(blobs[digest(data)])
        assert digest(content) == blobs[digest(data)].digest
        assert codec.inflater(content)(content) == data
    assert {blob.media_type for blob in blobs.values()} == {MEDIA_TYPES[encoding]}


@pytest.mark.parametrize("form", FORMS)
def test_the_configuration_is_kept_byte_for_byte(tmp_path: Path, form: Form) -> None:
    """Its digest is the image's name; it comes with the layers, and alone where these are not wanted."""
    desk = Desk(tmp_path, TALKER, form=form)
    assert desk.cache.config(TALKER.image) == TALKER.config
    assert (desk.cache.config(TALKER.image), desk.exports) == (TALKER.config, 1)
    other = Desk(tmp_path / "other", TALKER, form=form)
    other.cache.pack(TALKER.image, TALKER.diff_ids, "zstd")
    assert (other.cache.config(TALKER.image), other.exports) == (TALKER.config, 1)


@pytest.mark.parametrize("form", FORMS)
def test_the_engine_is_asked_once(tmp_path: Path, form: Form) -> None:
    """For all robots, and for the next run as well; only another encoding needs the layers again."""
    desk = Desk(tmp_path, TALKER, form=form)
    first = desk.cache.pack(TALKER.image, TALKER.diff_ids, "zstd")
    assert desk.cache.pack(TALKER.image, TALKER.diff_ids, "zstd") == first
    assert desk.another().pack(TALKER.image, TALKER.diff_ids[:1], "zstd") == {
        TALKER.diff_ids[0]: first[TALKER.diff_ids[0]]
    }
    assert desk.exports == 1
    desk.cache.pack(TALKER.image, TALKER.diff_ids, "gzip")
    assert desk.exports == 2


def test_layers_that_another_image_brought_are_there(tmp_path: Path) -> None:
    """Images that share their lower layers have these packed once."""
    camera = Handmade(layers=(BASE, layer(3)), reference="camera:1")
    desk = Desk(tmp_path, TALKER, camera)
    before = desk.cache.pack(TALKER.image, TALKER.diff_ids, "zstd")
    assert desk.cache.pack(camera.image, (digest(BASE),), "zstd")[digest(BASE)] == before[digest(BASE)]
    assert desk.exports == 1


@pytest.mark.parametrize("form", FORMS)
def test_only_layers_that_are_wanted_are_kept(tmp_path: Path, form: Form) -> None:
    """What a robot has anyway need not fill this computer's disk."""
    desk = Desk(tmp_path, TALKER, form=form)
    assert set(desk.cache.pack(TALKER.image, TALKER.diff_ids[1:], "gzip")) == {TALKER.diff_ids[1]}
    assert sum(path.stat().st_size for path in desk.folder.iterdir()) < 1.2 * len(CODE)
    assert not [path for path in desk.folder.iterdir() if path.name.startswith(".")]


def test_what_an_old_engine_calls_a_layer_is_learned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its name there does not say its digest: the second time only what is missing is packed, by any run."""
    desk = Desk(tmp_path, TALKER)
    desk.cache.pack(TALKER.image, TALKER.diff_ids[:1], "gzip")
    compressors: list[str] = []

    class Counted(codec.Compressor):
        def __init__(self, encoding: Encoding) -> None:
            compressors.append(encoding)
            super().__init__(encoding)

    monkeypatch.setattr(codec, "Compressor", Counted)
    desk.another().pack(TALKER.image, TALKER.diff_ids[1:], "gzip")
    assert compressors == ["gzip"]


@pytest.mark.parametrize("form", FORMS)
def test_a_layer_that_an_image_has_twice(tmp_path: Path, form: Form) -> None:
    """Old engines write a link in place of the second, others name one blob twice."""
    twice = Handmade(layers=(BASE, CODE, BASE))
    desk = Desk(tmp_path, twice, form=form)
    assert set(desk.cache.pack(twice.image, twice.diff_ids, "gzip")) == set(twice.diff_ids)


@pytest.mark.parametrize(
    ("encoding", "tail"), [("gzip", b""), ("zstd", b""), ("zstd", b"\x50\x2a\x4d\x18\x03\0\0\0abc")]
)
def test_layers_of_several_streams_are_read_to_the_end(
    tmp_path: Path, encoding: Encoding, tail: bytes
) -> None:
    """Some builders pack file by file (stargz, zstd:chunked) and add what only they read: a layer is all of them."""
    parts = (BASE[:10_000], BASE[10_000:20_000], BASE[20_000:])
    content = b"".join(packed(part, encoding)[1] for part in parts) + tail
    image = Handmade(layers=(BASE,))
    path = f"blobs/sha256/{digest(content)[7:]}"
    listing = json.dumps([{"Config": "config.json", "RepoTags": [], "Layers": [path]}]).encode()
    archive = tar({path: content, "config.json": image.config, "manifest.json": listing})
    desk = Desk(tmp_path, image, archive=archive)
    assert set(desk.cache.pack(image.image, image.diff_ids, "gzip")) == set(image.diff_ids)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
    ],
    ids=["removed", "emptied", "cut"],
)
@pytest.mark.parametrize("which", ["note", "layer", "both"])
def test_what_somebody_spoiled_in_between_is_made_again(tmp_path: Path, spoil: object, which: str) -> None:
    """The cache may be cleared at any time, also by a disk that was full."""
    assert callable(spoil)
    desk = Desk(tmp_path, TALKER)
    first = desk.cache.pack(TALKER.image, TALKER.diff_ids, "gzip")
    files = {"note": f"{digest(BASE)[7:]}.gzip.json", "layer": first[digest(BASE)].hex}
    for name in files.values() if which == "both" else [files[which]]:
        spoil(desk.folder / name)
    assert desk.cache.pack(TALKER.image, TALKER.diff_ids, "gzip") == first
    assert desk.content(first[digest(BASE)]) == packed(BASE)[1]
    assert desk.exports == 2


def flip(path: Path) -> None:
    """Change a bit in the middle of a file: its length and its name stay."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_a_layer_that_is_damaged_is_made_again_before_it_is_sent(tmp_path: Path) -> None:
    """A robot would find it out only when it has it; each run looks at each file once."""
    desk = Desk(tmp_path, TALKER)
    first = desk.cache.pack(TALKER.image, TALKER.diff_ids, "gzip")
    flip(desk.folder / first[digest(BASE)].hex)
    assert desk.another().pack(TALKER.image, TALKER.diff_ids, "gzip") == first
    assert desk.content(first[digest(BASE)]) == packed(BASE)[1]
    assert desk.exports == 2
    flip(desk.folder / first[digest(CODE)].hex)
    with desk.another().unpacked(digest(CODE)) as found:
        assert found is None


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"digest": 1}', "\xff"])
@pytest.mark.parametrize("name", ["names", f"{digest(BASE)[7:]}.gzip.json"])
def test_notes_that_are_none_are_written_again(tmp_path: Path, name: str, text: str) -> None:
    """Of another version, or of a computer that lost power."""
    desk = Desk(tmp_path, TALKER)
    desk.folder.mkdir()
    (desk.folder / name).write_text(text, encoding="latin-1")
    assert set(desk.cache.pack(TALKER.image, TALKER.diff_ids, "gzip")) == set(TALKER.diff_ids)


def test_a_layer_that_was_removed_when_it_is_needed(tmp_path: Path) -> None:
    """One sentence, and its cure."""
    desk = Desk(tmp_path, TALKER)
    with pytest.raises(DesktopError) as caught:
        desk.cache.open("f" * 64)
    assert caught.value.what == f"a packed layer was removed from {desk.folder}: No such file or directory"
    assert caught.value.cure == "run the same command again"


SAVED = TALKER.saved("plain blobs")


@pytest.mark.parametrize(
    ("archive", "what"),
    [
        (SAVED[: len(SAVED) // 3], "packing layers for sending failed: unexpected end of data"),
        (b"no tar at all", "packing layers for sending failed: "),
        (tar({}), "talker:latest-amd64 is another image than a moment ago"),
        (tar({"manifest.json": b"[]"}), "talker:latest-amd64 is another image than a moment ago"),
        (tar({"manifest.json": b"7"}), "talker:latest-amd64 is another image than a moment ago"),
        (tar({"manifest.json": b"{"}), "talker:latest-amd64 is another image than a moment ago"),
        (
            tar({"c": TALKER.config, "manifest.json": b"[]"}),
            "layers are missing in the archive of talker:latest-amd64",
        ),
        (tar({"x": b"\x1f\x8b damaged"}), "packing layers for sending failed: "),
        (tar({"x": b"\x28\xb5\x2f\xfd damaged"}), "packing layers for sending failed: "),
    ],
)
def test_an_archive_that_is_no_good_is_one_sentence(tmp_path: Path, archive: bytes, what: str) -> None:
    """Nothing half is left."""
    desk = Desk(tmp_path, TALKER, archive=archive)
    with pytest.raises(DesktopError) as caught:
        desk.cache.pack(TALKER.image, TALKER.diff_ids, "gzip")
    assert caught.value.what.startswith(what)
    assert not [path for path in desk.folder.iterdir() if path.name.startswith(".")]


def test_a_cache_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    """With where it is."""
    (tmp_path / "layers").write_text("in the way")
    with pytest.raises(DesktopError) as caught:
        Desk(tmp_path, TALKER).cache.pack(TALKER.image, TALKER.diff_ids, "gzip")
    assert caught.value.what.startswith("packing layers for sending failed: ")
    assert caught.value.cure == "check that ~/.cache has free disk space"


def test_tidying_keeps_what_was_used_last(tmp_path: Path) -> None:
    """The time of use counts: a layer that every release has stays, however old it is."""
    images = [Handmade(layers=(layer(seed),), reference=f"image:{seed}") for seed in range(4)]
    desk = Desk(tmp_path, *images)
    blobs = [desk.cache.pack(one.image, one.diff_ids, "gzip")[one.diff_ids[0]] for one in images]
    for path in desk.folder.iterdir():
        os.utime(path, (1000, 1000))
    for number, blob in enumerate(blobs):
        os.utime(desk.folder / blob.hex, (2000 + number, 2000 + number))
    desk.cache.pack(images[0].image, images[0].diff_ids, "gzip")
    desk.cache.tidy(most=2 * max(blob.size for blob in blobs) + 1000)
    assert [(desk.folder / blob.hex).exists() for blob in blobs] == [True, False, False, True]
    assert sum(path.stat().st_size for path in desk.folder.iterdir()) <= 2 * blobs[0].size + 2000


def test_tidying_what_is_small_removes_nothing(tmp_path: Path) -> None:
    """A cache without a folder is not an error either."""
    desk = Desk(tmp_path, TALKER)
    desk.cache.tidy()
    desk.cache.pack(TALKER.image, TALKER.diff_ids, "gzip")
    before = set(desk.folder.iterdir())
    desk.cache.tidy()
    assert set(desk.folder.iterdir()) == before


def test_many_want_the_same_at_once(tmp_path: Path) -> None:
    """Robots of one run wait for each other; two runs work side by side, and both have it right."""
    desk = Desk(tmp_path, TALKER)
    caches = [desk.cache, desk.another()]
    results: list[dict[str, Blob]] = []

    def pack(one: LayerCache) -> None:
        results.extend(one.pack(TALKER.image, TALKER.diff_ids, "gzip") for _ in range(3))

    threads = [threading.Thread(target=pack, args=(one,)) for one in caches * 3]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [results[0]] * 18
    assert desk.exports <= 2
    assert {blob.hex for blob in results[0].values()} <= {path.name for path in desk.folder.iterdir()}


@pytest.mark.usefixtures("desktop")
def test_out_of_the_engine_of_this_computer(tmp_path: Path) -> None:
    """Its own archive, whatever version it is: the layers are those that went in, and the ID is the configuration's."""
    engine = Engine()
    image = Handmade(layers=(layer(os.getpid()), layer(7)), reference=f"{engine.name}:latest-amd64")
    try:
        engine.load(image.saved())
        with Store() as store:
            stored = store.find(image.reference, "linux/amd64")
            here = LayerCache(directory=tmp_path, export=store.export)
            blobs = here.pack(stored, stored.layers, "gzip")
            assert stored.identity == image.image.identity
            assert blobs == {digest(data): packed(data)[0] for data in image.layers}
            assert here.config(stored) == image.config
    finally:
        engine.clear()


@pytest.mark.parametrize(("variable", "where"), [("", ".cache"), ("other", "other")])
def test_where_the_cache_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, where: str
) -> None:
    """In the login's own, unless XDG_CACHE_HOME says another place."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", variable and str(tmp_path / variable))
    assert layer_cache.folder() == tmp_path / where / "fleet/layers"


class Pushing(Desk):
    """An engine that pushes, too; ``pushes`` are the files that arrive, by name."""

    def __init__(self, folder: Path, *images: Handmade, pushes: Mapping[str, bytes]) -> None:
        super().__init__(folder, *images)
        self._pushes = pushes
        self.exported: list[Image] = []
        self.cache = LayerCache(
            directory=self.folder, export=self._export, pushed=self._pushed, exported=self.exported.append
        )
        folder.mkdir(exist_ok=True)

    @contextlib.contextmanager
    def _pushed(self, _image: Image, _layers: Collection[str]) -> Iterator[dict[str, Path]]:
        files = {}
        for name, data in self._pushes.items():
            files[name] = self.folder.parent / name.removeprefix("sha256:")
            files[name].write_bytes(data)
        yield files


CONFIGURATION = {digest(TALKER.config): TALKER.config}


@pytest.mark.parametrize("plain", [True, False])
def test_a_pushed_layer_needs_no_archive(tmp_path: Path, plain: bool) -> None:
    """A classic store packs it with gzip; a containerd store pushes it as it is there. The bytes that are sent are the same."""
    content = CODE if plain else gzip.compress(CODE)
    desk = Pushing(tmp_path, TALKER, pushes={**CONFIGURATION, digest(content): content})
    assert desk.cache.pack(TALKER.image, [digest(CODE)], "zstd") == {digest(CODE): packed(CODE, "zstd")[0]}
    assert (desk.cache.config(TALKER.image), desk.exports, desk.exported) == (TALKER.config, 0, [])


@pytest.mark.parametrize(
    "pushes",
    [
        {},
        CONFIGURATION,
        {digest(CODE): CODE},
        {**CONFIGURATION, digest(BASE): gzip.compress(BASE)},
        {**CONFIGURATION, digest(CODE): b"\x1f\x8b damaged"},
    ],
)
def test_a_push_that_did_not_bring_everything_is_made_up_for(
    tmp_path: Path, pushes: dict[str, bytes]
) -> None:
    """By the archive; and the engine may then prepare for the next time."""
    desk = Pushing(tmp_path, TALKER, pushes=pushes)
    assert desk.cache.pack(TALKER.image, [digest(CODE)], "zstd") == {digest(CODE): packed(CODE, "zstd")[0]}
    assert (desk.cache.config(TALKER.image), desk.exports, desk.exported) == (
        TALKER.config,
        1,
        [TALKER.image],
    )
