"""Pack layers out of this computer's Docker, and keep them for the next robot.

The cache is ``~/.cache/fleet/layers``. A file named by its digest has a layer's packed bytes; a note named by the layer's
diff ID describes them. Each layer is packed once; the files may be removed at any time.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import tarfile
import tempfile
import threading
from dataclasses import asdict
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fleet.errors import DesktopError
from fleet.images.chunks import SMALL, Chunks
from fleet.images.layer import PLAIN, Blob
from fleet.transfer import codec
from fleet.transfer.codec import ENCODINGS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
    from contextlib import AbstractContextManager

    from fleet.images.image import Image
    from fleet.transfer.codec import Encoding

    Export = Callable[[Image], Iterable[bytes]]
    Pushed = Callable[[Image, Collection[str]], AbstractContextManager[Mapping[str, Path]]]

MOST = 20_000_000_000
"""Bytes that the cache may hold when a run ends."""

_CHUNK = 1 << 20


def folder() -> Path:
    """The directory of the cache; the variable ``XDG_CACHE_HOME`` changes it."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet" / "layers"


@contextlib.contextmanager
def _nothing(_image: Image, _layers: Collection[str]) -> Generator[Mapping[str, Path]]:
    yield {}


class LayerCache:
    """The packed layers.

    ``export`` yields the chunks of an image's archive as ``docker save`` writes it. ``pushed`` has the configuration and
    some layers as files, or not, and is tried before. ``exported`` is called with an image that had to be exported.
    """

    def __init__(
        self,
        *,
        directory: Path,
        export: Export,
        pushed: Pushed = _nothing,
        exported: Callable[[Image], object] = lambda _: None,
    ) -> None:
        self._directory = directory
        self._export = export
        self._pushed = pushed
        self._exported = exported
        self._lock = threading.Lock()  # an image is exported once, although many robots need it
        self._names: dict[str, str] = {}
        self._sound: set[str] = set()  # digests of files whose bytes this run has read or written

    def pack(self, image: Image, diff_ids: Iterable[str], encoding: Encoding) -> dict[str, Blob]:
        """The layers ``diff_ids`` of an image, packed: from the cache, or else from Docker.

        Raises:
            DesktopError: Docker fails, its archive misses a layer, or the disk is full.

        """
        wanted = tuple(diff_ids)
        with self._lock, _explained():
            known = {diff_id: self._known(diff_id, encoding) for diff_id in wanted}
            missing = {diff_id for diff_id, blob in known.items() if blob is None}
            if missing:
                self._unpack(image, missing, encoding)
            known = {diff_id: blob or self._known(diff_id, encoding) for diff_id, blob in known.items()}
        blobs = {diff_id: blob for diff_id, blob in known.items() if blob}
        if len(blobs) < len(known):
            raise DesktopError(
                f"layers are missing in the archive of {image.reference}", cure="run `fab build` again"
            )
        return blobs

    def config(self, image: Image) -> bytes:
        """The configuration of an image, byte for byte: its digest is the image's identity. Raises like `pack`."""
        path = self._directory / f"{image.identity.removeprefix('sha256:')}.config"
        with self._lock, _explained():
            if not _is(path, image.identity):
                self._unpack(image, set(), None)
            os.utime(path)
            return path.read_bytes()

    def open(self, digest: str) -> IO[bytes]:
        """Open the packed bytes of a digest (hex). Raises ``DesktopError`` if they were removed."""
        try:
            return (self._directory / digest).open("rb")
        except OSError as problem:
            what = f"a packed layer was removed from {self._directory}: {problem.strerror}"
            raise DesktopError(what, cure="run the same command again") from problem

    def tidy(self, *, most: int = MOST) -> None:
        """Remove the least recently used files until at most ``most`` bytes are left."""
        with contextlib.suppress(OSError):
            files = sorted(
                (path.stat().st_mtime, path.stat().st_size, path) for path in self._directory.iterdir()
            )
            over = sum(size for _, size, _ in files) - most
            for _, size, path in files:
                if over > 0:
                    path.unlink(missing_ok=True)
                    over -= size

    @contextlib.contextmanager
    def unpacked(self, diff_id: str) -> Generator[IO[bytes] | None]:
        """The tar of a layer as a temporary file; None if the layer is not in the cache."""
        packed = next(filter(None, (self._known(diff_id, encoding) for encoding in ENCODINGS)), None)
        with _explained(), contextlib.ExitStack() as stack:
            plain = None
            if packed:
                content = stack.enter_context(self.open(packed.hex))
                plain = stack.enter_context(tempfile.TemporaryFile(dir=self._directory))
                plain.writelines(_inflated(content.read(_CHUNK), content))
            yield plain

    def keep(self, write: Callable[[IO[bytes]], object]) -> tuple[str, int]:
        """Keep a file that ``write`` fills; return its digest (hex), which is its name, and its size in bytes."""
        handle, part = tempfile.mkstemp(dir=self._directory, prefix=".part-")
        with _explained():
            try:
                with os.fdopen(handle, "w+b") as out:
                    write(out)
                    out.seek(0)
                    digest, size = hashlib.file_digest(out, "sha256").hexdigest(), out.tell()
                Path(part).replace(self._directory / digest)
                self._sound.add(digest)
            finally:
                Path(part).unlink(missing_ok=True)
        return digest, size

    def size(self, digest: str) -> int:
        """The size in bytes of the file of a digest (hex), which counts as used now. Raises ``OSError`` if it is missing.

        A file that is damaged is removed, and missing: a robot would find that out only after it was sent.
        """
        path = self._directory / digest
        os.utime(path)
        if digest not in self._sound:
            if not _is(path, f"sha256:{digest}"):
                path.unlink(missing_ok=True)
                raise FileNotFoundError(f"{path} was damaged")
            self._sound.add(digest)
        return path.stat().st_size

    def noted(self, name: str) -> str:
        """Read a note. Raises ``OSError`` if it is missing."""
        return (self._directory / name).read_text(encoding="utf-8")

    def note(self, name: str, text: str) -> None:
        """Keep a note. It is replaced in one step, because another run may read it."""
        part = self._directory / f".{name}.{os.getpid()}.{threading.get_ident()}"
        part.write_text(text, encoding="utf-8")
        part.replace(self._directory / name)

    def _known(self, diff_id: str, encoding: Encoding) -> Blob | None:
        with contextlib.suppress(OSError, ValueError, TypeError):
            blob = Blob(**json.loads(self.noted(_name(diff_id, encoding))))
            if self.size(blob.hex) == blob.size:
                return blob
        return None

    def _unpack(self, image: Image, missing: set[str], encoding: Encoding | None) -> None:
        """Keep the configuration of an image, and pack the layers that are missing: from a push, else from the archive."""
        self._directory.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(OSError, ValueError):
            self._names |= json.loads(self.noted("names"))
        if not self._from_push(image, missing, encoding):
            self._from_archive(image, missing, encoding)
            self._exported(image)
        self.note("names", json.dumps(self._names))

    def _from_push(self, image: Image, missing: set[str], encoding: Encoding | None) -> bool:
        """Whether a push has brought everything. Its bytes count by their digests, as those of an archive do."""
        small: dict[str, bytes] = {}
        with self._pushed(image, missing) as files:
            for digest, path in files.items():
                if path.stat().st_size <= SMALL:
                    small[digest] = path.read_bytes()
                if encoding and digest != image.identity:
                    with path.open("rb") as content, contextlib.suppress(*codec.DAMAGED):
                        self._layer(f"blobs/sha256/{path.name}", content, missing, encoding)
        packed = encoding is None or all(self._known(diff_id, encoding) for diff_id in missing)
        return self._keep_config(image, small) and packed

    def _from_archive(self, image: Image, missing: set[str], encoding: Encoding | None) -> None:
        small: dict[str, bytes] = {}
        stream = io.BufferedReader(Chunks(self._export(image)), _CHUNK)
        with tarfile.open(fileobj=stream, mode="r|", bufsize=_CHUNK) as archive:
            for member in archive:
                content = archive.extractfile(member) if member.isfile() else None
                if content is None:
                    continue
                if member.size <= SMALL:
                    small[member.name] = content.read()
                    content = io.BytesIO(small[member.name])
                if encoding:
                    self._layer(member.name, content, missing, encoding)
            stream.read()  # to the end, so that Docker can report an error
        if not self._keep_config(image, small):
            raise DesktopError(
                f"{image.reference} is another image than a moment ago", cure="run the same command again"
            )

    def _keep_config(self, image: Image, small: Mapping[str, bytes]) -> bool:
        """Keep the configuration; False if it is not among the small files."""
        hex_digest = image.identity.removeprefix("sha256:")
        for data in small.values():
            if hashlib.sha256(data).hexdigest() == hex_digest:
                self.note(f"{hex_digest}.config", data.decode())
                return True
        return False

    def _layer(self, name: str, content: IO[bytes], missing: set[str], encoding: Encoding) -> None:
        """Pack a member of the archive, and keep it if it is a missing layer.

        From Docker 25 on the name of an unpacked layer is its digest. Before, and for packed layers, only the bytes show
        which layer it is; the name is remembered for the next time, as Docker derives it from the layers up to that one.
        """
        first = content.read(_CHUNK)
        digest = name.removeprefix("blobs/sha256/")
        plain = f"sha256:{digest}" if digest != name and not codec.is_packed(first) else self._names.get(name)
        if plain and plain not in missing:
            return
        handle, part = tempfile.mkstemp(dir=self._directory, prefix=".part-")
        try:
            with os.fdopen(handle, "wb") as out:
                blob = _pack(_inflated(first, content), out, encoding)
            self._names[name] = blob.diff_id
            if blob.diff_id in missing:
                Path(part).replace(self._directory / blob.hex)
                self._sound.add(blob.hex)
                self.note(_name(blob.diff_id, encoding), json.dumps(asdict(blob)))
        finally:
            Path(part).unlink(missing_ok=True)


def _is(path: Path, digest: str) -> bool:
    """Whether a file is there with the content of that digest."""
    try:
        with path.open("rb") as content:
            return f"sha256:{hashlib.file_digest(content, 'sha256').hexdigest()}" == digest
    except OSError:
        return False


def _name(diff_id: str, encoding: Encoding) -> str:
    return f"{diff_id.removeprefix('sha256:')}.{encoding}.json"


def _pack(chunks: Iterable[bytes], out: IO[bytes], encoding: Encoding) -> Blob:
    """Write the tar of a layer packed, and return the description of the packed bytes."""
    compressor = codec.Compressor(encoding)
    plain, packed = hashlib.sha256(), hashlib.sha256()
    unpacked = size = 0

    def put(data: bytes) -> None:
        nonlocal size
        size += len(data)
        packed.update(data)
        out.write(data)

    for chunk in chunks:
        plain.update(chunk)
        unpacked += len(chunk)
        put(compressor.compress(chunk))
    put(compressor.flush())
    return Blob(
        diff_id=f"sha256:{plain.hexdigest()}",
        digest=f"sha256:{packed.hexdigest()}",
        size=size,
        media_type=f"{PLAIN}+{encoding.partition('-')[0]}",
        unpacked=unpacked,
    )


def _inflated(first: bytes, rest: IO[bytes]) -> Iterator[bytes]:
    """The unpacked bytes of a layer: a containerd store keeps layers packed as they were pulled."""
    inflate = codec.inflater(first)
    yield inflate(first)
    while chunk := rest.read(_CHUNK):
        yield inflate(chunk)


@contextlib.contextmanager
def _explained() -> Generator[None]:
    try:
        yield
    except (OSError, tarfile.TarError, *codec.DAMAGED) as problem:
        what = f"packing layers for sending failed: {problem}"
        raise DesktopError(what, cure="check that ~/.cache has free disk space") from problem
