"""Read a bundle on a desktop: its releases and images, for ``fab ship --from``. Every file is checked before it is used."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tarfile
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.bundle import index
from fleet.bundle.write import SUMS, listed
from fleet.errors import DesktopError, UsageError
from fleet.robot import release as releases
from fleet.transfer import load_archive
from fleet.transfer.load_archive import BLOCK, TargetImage

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterator, Mapping

    from fleet.bundle.index import Bundle, BundledImage, BundledStack
    from fleet.images.image import Image
    from fleet.images.layer import Blob
    from fleet.robot.release import Release

_CHUNK = 1 << 20
_AGAIN = "make the bundle again: `fab bundle`"


class BundleReader:
    """An open bundle. As a source of images it stands in for this computer's Docker (`fleet.images.store.Store`)."""

    def __init__(self, folder: Path, bundle: Bundle) -> None:
        self.bundle = bundle
        self._folder = folder

    def release(self, robot: str, stack: BundledStack) -> Release:
        """A robot's release of a stack. Raises `UsageError` if it cannot be read."""
        images = tuple(self.bundle.images[name].image for name in stack.images)
        try:
            data = (self._folder / "releases" / stack.file).read_bytes()
            return releases.unpacked(data, name=stack.release, stack=stack.name, robot=robot, images=images)
        except (OSError, ValueError, KeyError, tarfile.TarError) as problem:
            what = f"release {stack.release} of {robot} in the bundle cannot be read: {problem}"
            raise UsageError(what, cure=_AGAIN) from problem

    def export(self, image: Image) -> Generator[bytes]:
        """The image as ``docker save`` would write it: for the layer cache."""
        yield from self.archive(image.reference, image.shipped_as)

    @contextlib.contextmanager
    def pushed(self, _image: Image, _layers: Collection[str]) -> Generator[Mapping[str, Path]]:
        """Nothing: a bundle is read from its files anyway."""
        yield {}

    def prime(self, _image: Image) -> None:
        """Nothing, as `pushed`."""

    def archive(self, _local: str, reference: str) -> Generator[bytes]:
        """The image that robots call ``reference``, as an archive for ``docker load`` under that name."""
        one = self.bundle.images[reference]
        blobs = {diff_id: self.bundle.layers[diff_id] for diff_id in one.image.layers}
        members = tuple({blob.digest: blob for blob in blobs.values()}.values())
        target = TargetImage(name=reference, fingerprint=one.image.fingerprint, config=self._config(one))
        skeleton = load_archive.skeleton([target], blobs=blobs, sent=members, incoming=False).data
        for number, blob in enumerate(members):
            yield skeleton[number * BLOCK : (number + 1) * BLOCK]
            yield from self._layer(blob)
            yield bytes(-blob.size % BLOCK)
        yield skeleton[len(members) * BLOCK :]
        yield bytes(2 * BLOCK)

    def _config(self, one: BundledImage) -> bytes:
        """The configuration: the first member of the file after the headers of the layers."""
        data = (self._folder / "images" / one.file).read_bytes()
        at = BLOCK * len({self.bundle.layers[diff_id].digest for diff_id in one.image.layers})
        size = tarfile.TarInfo.frombuf(data[at : at + BLOCK], "utf-8", "strict").size
        config = data[at + BLOCK : at + BLOCK + size]
        if f"sha256:{hashlib.sha256(config).hexdigest()}" != one.image.identity:
            raise DesktopError(f"image {one.image.shipped_as} in the bundle cannot be read", cure=_AGAIN)
        return config

    def _layer(self, blob: Blob) -> Iterator[bytes]:
        for part in sorted((self._folder / "layers").glob(f"{blob.hex}.[0-9][0-9]")):
            with part.open("rb") as content:
                while chunk := content.read(_CHUNK):
                    yield chunk


@contextlib.contextmanager
def opened(path: Path) -> Generator[BundleReader]:
    """Open a bundle: a folder, or a tar archive of one, which is unpacked for as long as it is used.

    Raises:
        UsageError: it is not a bundle, not whole, or has been edited.

    """
    if not path.exists():
        raise UsageError(
            f"there is no bundle {path}", cure="name the folder of the stick, or the tar archive"
        )
    with contextlib.ExitStack() as stack:
        try:
            folder = path if path.is_dir() else stack.enter_context(_untarred(path))
            digests = listed(folder)
            if not digests:
                cure = f"a bundle has a file {SUMS}; if it is missing, `fab bundle` was interrupted: run it again"
                raise UsageError(f"{path} is not a bundle of fleet, or not a whole one", cure=cure)
            _check(folder, digests)
            text = (folder / next(name for name in digests if name.startswith("index-"))).read_text()
            reader = BundleReader(folder, index.parse(text))
        except (OSError, tarfile.TarError, UnicodeDecodeError, StopIteration) as problem:
            raise UsageError(f"the bundle {path} cannot be read: {problem}", cure=_AGAIN) from problem
        yield reader


@contextlib.contextmanager
def _untarred(path: Path) -> Generator[Path]:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet"
    cache.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path) as archive, tempfile.TemporaryDirectory(dir=cache, prefix="bundle-") as folder:
        archive.extractall(folder, filter="data")
        yield Path(folder)


def _check(folder: Path, digests: Mapping[str, str]) -> None:
    """Check every file. Raises `UsageError` with the first one that is not what was written."""
    for name, digest in digests.items():
        try:
            with (folder / name).open("rb") as content:
                found = hashlib.file_digest(content, "sha256").hexdigest()
        except (FileNotFoundError, NotADirectoryError):
            raise UsageError(f"{name} is missing in the bundle {folder}", cure=_AGAIN) from None
        if found != digest:
            what = f"{name} in the bundle {folder} is not what `fab bundle` wrote: it was cut short or edited"
            raise UsageError(what, cure=_AGAIN)
