"""Images made by hand: their layers and configuration, and the archives of them that ``docker save`` writes."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import random
import subprocess
import tarfile
import uuid
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from fleet.images.image import Image
from fleet.images.layer import Blob
from fleet.transfer import codec
from fleet.transfer.load_archive import TargetImage

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.transfer.codec import Encoding

Form = Literal["20.10", "plain blobs", "gzip blobs", "zstd blobs"]
FORMS: tuple[Form, ...] = ("20.10", "plain blobs", "gzip blobs", "zstd blobs")
"""What engines write: before Docker 25; from then on; and from a containerd store, layers packed as they were pulled."""

MEDIA_TYPES = {
    "gzip": "application/vnd.oci.image.layer.v1.tar+gzip",
    "zstd": "application/vnd.oci.image.layer.v1.tar+zstd",
    "zstd-long": "application/vnd.oci.image.layer.v1.tar+zstd",
}


def digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def tar(members: Mapping[str, bytes | str]) -> bytes:
    """A tar; a member that is text is a link to that."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, data in members.items():
            entry = tarfile.TarInfo(name)
            if isinstance(data, str):
                entry.type, entry.linkname = tarfile.SYMTYPE, data
                archive.addfile(entry)
            else:
                entry.size = len(data)
                archive.addfile(entry, io.BytesIO(data))
    return buffer.getvalue()


def layer(seed: int, *, size: int = 40_000) -> bytes:
    """A layer's tar, whose file cannot be packed smaller; each seed has its own."""
    return tar({f"file {seed}": random.Random(seed).randbytes(size)})  # noqa: S311  no secret


def packed(data: bytes, encoding: Encoding = "gzip") -> tuple[Blob, bytes]:
    """A layer as it travels, and its bytes."""
    compressor = codec.Compressor(encoding)
    content = compressor.compress(data) + compressor.flush()
    blob = Blob(
        diff_id=digest(data),
        digest=digest(content),
        size=len(content),
        media_type=MEDIA_TYPES[encoding],
        unpacked=len(data),
    )
    return blob, content


@dataclass(frozen=True, kw_only=True)
class Handmade:
    """An image. ``reference`` is its name, ``run`` the part of its configuration that says how it runs."""

    layers: tuple[bytes, ...]
    reference: str = "talker:latest-amd64"
    run: Mapping[str, Any] = field(default_factory=dict)

    @property
    def diff_ids(self) -> tuple[str, ...]:
        return tuple(map(digest, self.layers))

    @property
    def config(self) -> bytes:
        described = {
            "architecture": "amd64",
            "os": "linux",
            "config": self.run,
            "rootfs": {"type": "layers", "diff_ids": self.diff_ids},
            "history": [{"created_by": "a test"} for _ in self.layers],
        }
        return json.dumps(described).encode()

    @property
    def image(self) -> Image:
        return Image(
            reference=self.reference,
            platform="linux/amd64",
            size=sum(map(len, self.layers)),
            identity=digest(self.config),
            layers=self.diff_ids,
        )

    @property
    def wanted(self) -> TargetImage:
        return TargetImage(name=self.image.shipped_as, fingerprint=self.image.fingerprint, config=self.config)

    def saved(self, form: Form = "20.10") -> bytes:
        """The archive of it."""
        return tar(self._old() if form == "20.10" else self._blobs(form))

    def _old(self) -> dict[str, bytes | str]:
        """A layer that comes a second time is a link to the first, as Docker writes it."""
        members: dict[str, bytes | str] = {}
        first: dict[bytes, str] = {}
        paths = []
        chain = ""
        for data in self.layers:
            chain = hashlib.sha256(f"{chain} {digest(data)}".encode()).hexdigest()
            members |= {f"{chain}/VERSION": b"1.0", f"{chain}/json": b"{}"}
            paths.append(f"{chain}/layer.tar")
            members[paths[-1]] = f"../{first[data]}" if data in first else data
            first.setdefault(data, paths[-1])
        config = f"{digest(self.config)[7:]}.json"
        return {**members, config: self.config, **self._manifest(config, paths), "repositories": b"{}"}

    def _blobs(self, form: Form) -> dict[str, bytes | str]:
        contents = [_as_stored(data, form) for data in self.layers]
        blobs: dict[str, bytes | str] = {_path(content): content for content in (*contents, self.config)}
        listing = self._manifest(_path(self.config), [_path(content) for content in contents])
        return {**blobs, "index.json": b"{}", **listing, "oci-layout": b'{"imageLayoutVersion":"1.0.0"}'}

    def _manifest(self, config: str, paths: Sequence[str]) -> dict[str, bytes | str]:
        listing = [{"Config": config, "RepoTags": [self.reference], "Layers": paths}]
        return {"manifest.json": json.dumps(listing).encode()}


def _path(content: bytes) -> str:
    return f"blobs/sha256/{digest(content)[7:]}"


def _as_stored(data: bytes, form: Form) -> bytes:
    if form == "gzip blobs":
        return gzip.compress(data, mtime=0)
    return packed(data, "zstd")[1] if form == "zstd blobs" else data


class Engine:
    """The Docker of this computer, for images under names that nobody else has; `clear` removes them."""

    def __init__(self) -> None:
        self.name = f"fleet-test-{uuid.uuid4().hex[:12]}"
        self.incoming = f"{self.name}-incoming"

    def load(self, archive: bytes) -> None:
        subprocess.run(("docker", "load", "--quiet"), input=archive, check=True, capture_output=True)

    def says(self, *argv: str) -> str:
        return subprocess.run(
            ("docker", *argv), check=True, capture_output=True, text=True, timeout=60
        ).stdout.strip()

    def tags(self, name: str = "") -> list[str]:
        """Of that repository; without a name of this engine's own."""
        return sorted(self.says("image", "ls", "--format", "{{.Tag}}", name or self.name).split())

    def clear(self) -> None:
        if left := self.says("ps", "-aq", "--filter", f"label={self.incoming}").split():
            self.says("rm", "--volumes", *left)
        for name in (self.name, self.incoming):
            if names := [f"{name}:{tag}" for tag in self.tags(name)]:
                self.says("image", "rm", "--force", *names)
