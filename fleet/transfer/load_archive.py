"""What does ``docker load`` read? An archive that holds some layers only, and names all of them.

One archive serves every engine from 20.10 on: a classic store reads ``manifest.json`` (docker's own format), a
containerd store ``index.json`` (opencontainers/image-spec, image-layout.md). The small members and the tar headers of
the layers make the *frame*; on the robot, frame and layers are put together as the archive flows into ``docker load``.
"""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.images.layer import PLAIN

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.images.layer import Blob

BLOCK = 512
"""Bytes of a tar header, and what members are padded to (POSIX pax, ustar interchange format)."""

INCOMING = "fleet/incoming"
"""The private repository of images that are not proved yet."""

_MANIFEST = "application/vnd.oci.image.manifest.v1+json"
_CONFIG = "application/vnd.oci.image.config.v1+json"
_INDEX = "application/vnd.oci.image.index.v1+json"


@dataclass(frozen=True, kw_only=True)
class TargetImage:
    """An image that a robot is to have: its configuration, byte for byte, and the name it gets there."""

    name: str
    fingerprint: str
    config: bytes

    @property
    def incoming(self) -> str:
        """Its name until it is proved."""
        return f"{INCOMING}:{self.fingerprint}"

    @property
    def diff_ids(self) -> tuple[str, ...]:
        """Its layers, lowest first."""
        return tuple(json.loads(self.config)["rootfs"]["diff_ids"])


@dataclass(frozen=True, kw_only=True)
class StoredManifest:
    """What is known of an image before it is sent.

    ``ids`` are what ``docker image inspect`` calls it: the digest of its configuration on a classic store, of its manifest
    on containerd's. The manifest lies in the frame, ``length`` bytes from ``offset``.
    """

    image: TargetImage
    ids: tuple[str, str]
    offset: int
    length: int


@dataclass(frozen=True, kw_only=True)
class ArchiveSkeleton:
    """The archive without its layers: first a header for each layer that is sent, then the small members."""

    data: bytes
    receipts: tuple[StoredManifest, ...]

    @property
    def hex(self) -> str:
        """Its SHA-256."""
        return hashlib.sha256(self.data).hexdigest()


def frame(
    images: Sequence[TargetImage], *, blobs: Mapping[str, Blob], sent: Sequence[Blob]
) -> ArchiveSkeleton:
    """The frame of an archive with the layers ``sent``; ``blobs`` says by which bytes each diff ID is known, if it is.

    A layer without a blob is one that a classic store has, and is named by its diff ID there.
    """
    buffer = io.BytesIO(b"".join(_header(f"blobs/sha256/{blob.hex}", blob.size) for blob in sent))
    buffer.seek(0, io.SEEK_END)
    receipts = []
    index, listing = [], []
    for image in images:
        layers = [_descriptor(diff_id, blobs.get(diff_id)) for diff_id in image.diff_ids]
        config = _add(buffer, image.config)
        described = {"mediaType": _CONFIG, "digest": f"sha256:{config}", "size": len(image.config)}
        manifest = _json({"schemaVersion": 2, "mediaType": _MANIFEST, "config": described, "layers": layers})
        offset = buffer.tell() + BLOCK
        digest = _add(buffer, manifest)
        ids = (f"sha256:{config}", f"sha256:{digest}")
        receipts.append(StoredManifest(image=image, ids=ids, offset=offset, length=len(manifest)))
        index.append(_entry(image, digest=digest, size=len(manifest)))
        paths = [f"blobs/sha256/{str(layer['digest']).removeprefix('sha256:')}" for layer in layers]
        listing.append({"Config": f"blobs/sha256/{config}", "RepoTags": [image.incoming], "Layers": paths})
    _add(buffer, _json({"schemaVersion": 2, "mediaType": _INDEX, "manifests": index}), "index.json")
    _add(buffer, _json({"imageLayoutVersion": "1.0.0"}), "oci-layout")
    _add(buffer, _json(listing), "manifest.json")
    return ArchiveSkeleton(data=buffer.getvalue(), receipts=tuple(receipts))


def _descriptor(diff_id: str, blob: Blob | None) -> dict[str, object]:
    if blob is None:
        return {"mediaType": PLAIN, "digest": diff_id, "size": 0}
    return {"mediaType": blob.media_type, "digest": blob.digest, "size": blob.size}


def _entry(image: TargetImage, *, digest: str, size: int) -> dict[str, object]:
    """An image in the index; containerd wants its name whole, with the registry that short names mean."""
    names = {
        "io.containerd.image.name": f"docker.io/{image.incoming}",
        "org.opencontainers.image.ref.name": image.fingerprint,
    }
    return {"mediaType": _MANIFEST, "digest": f"sha256:{digest}", "size": size, "annotations": names}


def _add(buffer: io.BytesIO, data: bytes, name: str = "") -> str:
    """Append a member, a blob where it has no name; the SHA-256 of its data."""
    digest = hashlib.sha256(data).hexdigest()
    buffer.write(_header(name or f"blobs/sha256/{digest}", len(data)))
    buffer.write(data + bytes(-len(data) % BLOCK))
    return digest


def _header(name: str, size: int) -> bytes:
    member = tarfile.TarInfo(name)
    member.size = size
    # GNU's form, because ustar's ends at 8 GiB; the name always fits.
    return member.tobuf(tarfile.GNU_FORMAT)


def _json(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()
