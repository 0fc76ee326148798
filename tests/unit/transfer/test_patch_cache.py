from __future__ import annotations

from typing import IO, TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.transfer import patch_format
from fleet.transfer.layer_cache import LayerCache
from fleet.transfer.patch_cache import PatchCache
from tests.support.handmade import Handmade, digest, layer
from tests.support.layers import made

if TYPE_CHECKING:
    from pathlib import Path

OLD, NEW = layer(1), layer(1) + layer(2)
IMAGE = Handmade(layers=(OLD, NEW))


def filled(folder: Path, *layers: bytes) -> LayerCache:
    """A cache in which these layers are packed."""
    cache = LayerCache(directory=folder / "layers", export=lambda _: [IMAGE.saved()])
    cache.pack(IMAGE.image, map(digest, layers), "gzip")
    return cache


def test_a_patch_is_kept_under_its_digest(tmp_path: Path) -> None:
    """It is the patch that `patch_format` makes, ready to be uploaded."""
    cache = filled(tmp_path, OLD, NEW)
    patch = PatchCache(cache).make(old=digest(OLD), new=digest(NEW))
    assert patch
    with cache.open(patch.digest) as file:
        content = file.read()
    assert content == made(OLD, NEW)
    assert (digest(content), len(content)) == (f"sha256:{patch.digest}", patch.size)


def test_a_patch_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another robot and another run get the same one; a patch that was removed is made again."""
    calls = []

    def counted(old: IO[bytes], new: IO[bytes], out: IO[bytes]) -> int:
        calls.append(new)
        return original(old, new, out)

    original = patch_format.make
    monkeypatch.setattr(patch_format, "make", counted)
    cache = filled(tmp_path, OLD, NEW)
    patches = [PatchCache(cache).make(old=digest(OLD), new=digest(NEW)) for _ in range(2)]
    assert patches[0] == patches[1] is not None
    assert len(calls) == 1
    (tmp_path / "layers" / patches[1].digest).unlink()
    assert PatchCache(cache).make(old=digest(OLD), new=digest(NEW)) == patches[0]
    assert len(calls) == 2


@pytest.mark.parametrize("packed", [(OLD,), (NEW,)])
def test_layers_that_were_not_packed_here_have_no_patch(tmp_path: Path, packed: tuple[bytes, ...]) -> None:
    """Both contents are needed."""
    assert PatchCache(filled(tmp_path, *packed)).make(old=digest(OLD), new=digest(NEW)) is None


def test_a_full_disk_is_an_error_of_the_desktop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing incomplete is left in the cache."""

    def full(*_: IO[bytes]) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(patch_format, "make", full)
    cache = filled(tmp_path, OLD, NEW)
    with pytest.raises(DesktopError, match="No space left on device"):
        PatchCache(cache).make(old=digest(OLD), new=digest(NEW))
    assert not list((tmp_path / "layers").glob(".part-*"))
