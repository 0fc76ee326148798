"""Read a bundle on a desktop: its releases and images, for ``fab ship --from``. Every file is checked before it is used."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import lzma
import os
import tarfile
import tempfile
import zlib
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
_PUT_IN = "if the stick was pulled out, put it in and run the same command; else make the bundle again: `fab bundle`"
_DAMAGED = (tarfile.TarError, EOFError, zlib.error, lzma.LZMAError, UnicodeDecodeError)
"""What an archive raises, packed or not, that was cut short or edited."""
_FOR_PEOPLE = ("install", "READ-ME.txt")
"""No ship reads these: who has opened one in an editor keeps the bundle."""


class BundleReader:
    """An open bundle. As a source of images it stands in for this computer's Docker (`fleet.images.store.Store`)."""

    def __init__(self, folder: Path, bundle: Bundle) -> None:
        self.bundle = bundle
        self._folder = folder

    def release(self, robot: str, stack: BundledStack) -> Release:
        """A robot's release of a stack. Raises `UsageError` if it cannot be read."""
        images = tuple(self.bundle.images[name].image for name in stack.images)
        data = self._read(f"releases/{stack.file}")
        try:
            return releases.unpacked(data, name=stack.release, stack=stack.name, robot=robot, images=images)
        except (ValueError, KeyError, tarfile.TarError) as problem:
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
        data = self._read(f"images/{one.file}")
        at = BLOCK * len({self.bundle.layers[diff_id].digest for diff_id in one.image.layers})
        size = tarfile.TarInfo.frombuf(data[at : at + BLOCK], "utf-8", "strict").size
        config = data[at + BLOCK : at + BLOCK + size]
        if f"sha256:{hashlib.sha256(config).hexdigest()}" != one.image.identity:
            raise DesktopError(f"image {one.image.shipped_as} in the bundle cannot be read", cure=_AGAIN)
        return config

    def _layer(self, blob: Blob) -> Iterator[bytes]:
        left = blob.size
        with _explained(f"layer {blob.hex[:12]} in the bundle {self._folder}"):
            for part in sorted((self._folder / "layers").glob(f"{blob.hex}.[0-9][0-9]")):
                with part.open("rb") as content:
                    while chunk := content.read(_CHUNK):
                        left -= len(chunk)
                        yield chunk
            if left:
                raise OSError(errno.EIO, "it has another size than a moment ago")

    def _read(self, name: str) -> bytes:
        with _explained(f"{name} in the bundle {self._folder}"):
            return (self._folder / name).read_bytes()


@contextlib.contextmanager
def opened(path: Path) -> Generator[BundleReader]:
    """Open a bundle: a folder, or a tar archive of one, which is unpacked for as long as it is used.

    Raises:
        UsageError: it is not a bundle, not whole, or has been edited.
        DesktopError: the stick fails, or there is no room to unpack the archive.

    """
    with _explained(f"the bundle {path}"):
        there = path.exists()
    if not there:
        raise UsageError(
            f"there is no bundle {path}",
            cure="name the folder of the stick, or the tar archive; an image of a registry has its digest: NAME@sha256:...",
        )
    with contextlib.ExitStack() as stack:
        with _explained(f"the bundle {path}"):
            folder = path if path.is_dir() else stack.enter_context(_untarred(path))
            digests = listed(folder)
            if not digests:
                cure = f"a bundle has a file {SUMS}; if it is missing, `fab bundle` was interrupted: run it again"
                raise UsageError(f"{path} is not a bundle of fleet, or not a whole one", cure=cure)
            _check(path, folder, digests)
            name = next((one for one in digests if one.startswith("index-")), "index")
            reader = BundleReader(folder, index.parse((folder / name).read_text(encoding="utf-8")))
        yield reader


@contextlib.contextmanager
def _explained(what: str) -> Generator[None]:
    try:
        yield
    except OSError as problem:
        if problem.errno is None:  # of a module that unpacks
            raise UsageError(f"{what} was cut short or edited: {problem}", cure=_AGAIN) from problem
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT)
        cure = "check that ~/.cache has free disk space: an archive is unpacked there" if full else _PUT_IN
        raise DesktopError(f"{what} cannot be read: {problem.strerror}", cure=cure) from problem
    except _DAMAGED as problem:
        raise UsageError(f"{what} was cut short or edited: {problem}", cure=_AGAIN) from problem


def _tar(path: Path) -> tarfile.TarFile:
    try:
        return tarfile.open(path)
    except tarfile.ReadError as problem:
        what = f"{path} is neither a folder nor a tar archive, or it was cut short"
        raise UsageError(what, cure="name the folder of the stick, or the tar archive") from problem


@contextlib.contextmanager
def _untarred(path: Path) -> Generator[Path]:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet"
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache, prefix="bundle-") as folder:
        with _tar(path) as archive:
            archive.extractall(folder, filter="data")
        yield Path(folder)


def _check(path: Path, folder: Path, digests: Mapping[str, str]) -> None:
    """Check every file that a ship reads, of a bundle that people know as ``path``.

    Raises:
        UsageError: the first one that is not what was written.
        OSError: the stick was pulled out, or is failing.

    """
    for name, digest in digests.items():
        if name in _FOR_PEOPLE:
            continue
        try:
            with (folder / name).open("rb") as content:
                found = hashlib.file_digest(content, "sha256").hexdigest()
        except (FileNotFoundError, NotADirectoryError):
            (folder / SUMS).stat()  # of a stick that was pulled out, nothing is there any more
            raise UsageError(f"{name} is missing in the bundle {path}", cure=_AGAIN) from None
        if found != digest:
            what = f"{name} in the bundle {path} is not what `fab bundle` wrote: it was cut short or edited"
            raise UsageError(what, cure=_AGAIN)
