from __future__ import annotations

import contextlib
import errno
import io
import os
import shutil
import tarfile
from typing import TYPE_CHECKING, Any

import pytest

from fleet.bundle import read
from fleet.bundle.write import SUMS, Writer, write_tar
from fleet.config.compose import HOME
from fleet.errors import DesktopError, UsageError
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
    refused(tmp_path / "READ-ME.txt", "neither a folder nor a tar archive")
    refused(tmp_path / "nowhere", "there is no bundle")
    with (
        pytest.raises(DesktopError, match="cannot be read: File name too long"),
        read.opened(tmp_path / ("x" * 300)),
    ):
        pass


def test_a_file_for_people_that_was_opened_in_an_editor_costs_nothing(tmp_path: Path) -> None:
    """No ship reads it."""
    Writer(tmp_path).write(bundle()[1])
    for name in ("READ-ME.txt", "install"):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes().replace(b"\n", b"\r\n"))
    with read.opened(tmp_path) as reader:
        assert [one.name for one in reader.bundle.robots] == ["pi1", "pi2"]


@pytest.mark.parametrize("packed_with", ["", "gz", "xz", "bz2"])
def test_an_archive_that_was_cut_anywhere_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packed_with: str
) -> None:
    """Also one that somebody has packed, or in which a byte is another one. Without its padding it is whole."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "stick").mkdir()
    Writer(tmp_path / "stick").write(bundle("pi1")[1])
    path = tmp_path / "b.tar"
    with tarfile.open(path, f"w:{packed_with}") as archive:  # type: ignore[call-overload]
        archive.add(tmp_path / "stick", arcname=".")
    data = path.read_bytes()
    with read.opened(path):
        pass
    end = len(data.rstrip(b"\0"))
    for size in (*range(0, 600, 37), *range(600, end - 600, end // 60), *range(end - 600, end - 8, 37)):
        path.write_bytes(data[:size])
        if size < 0.9 * end:
            refused(path, "cut short|is missing in|not a bundle of fleet")
        else:
            with contextlib.suppress(UsageError), read.opened(path):
                pass
    for at in range(0, end, end // 60):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :])
        with contextlib.suppress(UsageError), read.opened(path):
            pass  # padding, a date
    assert list((tmp_path / "cache/fleet").iterdir()) == []


@pytest.mark.parametrize("name", ["index-*", "layers/*", "releases/*", "images/*", SUMS])
def test_a_stick_that_is_pulled_out_is_not_called_edited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """At any file: it can be put in again."""
    Writer(tmp_path).write(bundle("pi1")[1])
    file, opened = next(tmp_path.glob(name)), io.open

    def broken(path: object, *arguments: Any, **values: Any) -> Any:  # noqa: ANN401  as `open`
        if path == file:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return opened(path, *arguments, **values)  # type: ignore[call-overload]

    monkeypatch.setattr(io, "open", broken)
    with (
        pytest.raises(DesktopError, match="Input/output error; if the stick was pulled out"),
        read.opened(tmp_path),
    ):
        pass


def test_a_stick_that_is_pulled_out_later_says_so_too(tmp_path: Path) -> None:
    """While layers are packed, or a release is read; an empty folder is left where it was mounted."""
    (tmp_path / "stick").mkdir()
    Writer(tmp_path / "stick").write(bundle("pi1")[1])
    with read.opened(tmp_path / "stick") as reader:
        (stack,) = reader.bundle.robot("pi1").stacks
        shutil.rmtree(tmp_path / "stick")
        cache = LayerCache(directory=tmp_path / "layers", export=reader.export)
        for ask in (
            lambda: cache.pack(TALKER.image, TALKER.diff_ids, "zstd"),
            lambda: reader.release("pi1", stack),
        ):
            with pytest.raises(DesktopError, match="if the stick was pulled out"):
                ask()


def refused(path: Path, words: str) -> None:
    with pytest.raises(UsageError, match=words), read.opened(path):
        pass
