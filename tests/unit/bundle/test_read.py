from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.bundle import read
from fleet.bundle.write import SUMS, Writer, write_tar
from fleet.config.compose import HOME
from fleet.errors import UsageError
from fleet.transfer.layer_cache import LayerCache
from tests.support.bundles import LAYERS, TALKER, bundle, release
from tests.support.handmade import packed

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(params=["folder", "tar"])
def path(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A bundle of pi1 and pi2, in both forms."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    if request.param == "tar":
        write_tar(tmp_path / "b.tar", lambda folder: Writer(folder).write(bundle()[1]))
        return tmp_path / "b.tar"
    (tmp_path / "stick").mkdir()
    Writer(tmp_path / "stick").write(bundle()[1])
    return tmp_path / "stick"


def test_a_release_is_the_one_that_was_put_in(path: Path) -> None:
    """File by file, with links, modes and empty folders, for any home."""
    with read.opened(path) as reader:
        (stack,) = reader.bundle.robot("pi1").stacks
        found, wanted = reader.release("pi1", stack), release()
    for home in (HOME, "/home/pi", "/srv/$x"):
        assert found.files(home) == wanted.files(home)
        assert found.archive(home) == wanted.archive(home)
        assert found.checksum(home) == wanted.checksum(home)
    assert (found.id, found.stack, found.robot) == (wanted.id, wanted.stack, wanted.robot)
    assert (found.images, found.seeds, found.folders) == (wanted.images, wanted.seeds, wanted.folders)


def test_its_images_stand_in_for_docker(path: Path, tmp_path: Path) -> None:
    """The layer cache packs the same layers out of it, in any encoding, and finds the configuration."""
    with read.opened(path) as reader:
        cache = LayerCache(directory=tmp_path / "layers", export=reader.export)
        assert cache.config(TALKER.image) == TALKER.config
        blobs = cache.pack(TALKER.image, TALKER.diff_ids, "zstd")
    assert blobs == {blob.diff_id: blob for blob, _ in (packed(data, "zstd") for data in TALKER.layers)}


def test_a_bundle_is_checked_before_it_is_used(tmp_path: Path) -> None:
    """Truncated, edited, incomplete, or something else: a sentence each."""
    Writer(tmp_path).write(bundle()[1])
    blob = next(iter(LAYERS))
    layer = tmp_path / "layers" / f"{blob.hex}.01"
    data = layer.read_bytes()
    for content, words in ((data[:-1], "cut short or edited"), (data[:-1] + b"x", "cut short or edited")):
        layer.write_bytes(content)
        refused(tmp_path, words)
    layer.unlink()
    refused(tmp_path, "is missing in the bundle")
    (tmp_path / SUMS).unlink()
    refused(tmp_path, "not a bundle of fleet, or not a whole one")
    refused(tmp_path / "READ-ME.txt", "cannot be read")
    refused(tmp_path / "nowhere", "there is no bundle")


def refused(path: Path, words: str) -> None:
    with pytest.raises(UsageError, match=words), read.opened(path):
        pass
