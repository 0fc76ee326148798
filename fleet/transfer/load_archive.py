"""Make the archive that ``docker load`` reads: it names all layers of the images, and contains only some of them.

One archive serves every engine from 20.10 on: a classic store reads ``manifest.json`` (docker's own format), a
containerd store ``index.json`` (opencontainers/image-spec, image-layout.md). The *skeleton* is the archive without the
contents of its layers; the robot puts skeleton and layers together as the archive flows into ``docker load``.
"""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.config.image_reference import full_name
from fleet.images.layer import PLAIN

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.images.layer import Blob

BLOCK = 512
"""Bytes of a tar header; members are padded to a multiple of it (POSIX pax, ustar interchange format)."""

INCOMING = "fleet/incoming"
"""The repository of images that were loaded and not yet proved."""

MANIFEST = "application/vnd.oci.image.manifest.v1+json"
CONFIG = "application/vnd.oci.image.config.v1+json"
INDEX = "application/vnd.oci.image.index.v1+json"


@dataclass(frozen=True, kw_only=True)
class TargetImage:
    """An image that the robot shall have: its configuration, byte for byte, and its name on the robot."""

    name: str
    fingerprint: str
    config: bytes

    @property
    def incoming(self) -> str:
        """The name of the image until it is proved."""
        return f"{INCOMING}:{self.fingerprint}"

    @property
    def diff_ids(self) -> tuple[str, ...]:
        """The layers of the image, lowest first."""
        return tuple(json.loads(self.config)["rootfs"]["diff_ids"])


@dataclass(frozen=True, kw_only=True)
class StoredManifest:
    """The manifest of an image in a skeleton: ``length`` bytes from ``offset``.

    ``ids`` are the IDs that ``docker image inspect`` may print for the image: the digest of its configuration (classic
    store) and of its manifest (containerd store).
    """

    image: TargetImage
    ids: tuple[str, str]
    offset: int
    length: int


@dataclass(frozen=True, kw_only=True)
class ArchiveSkeleton:
    """The archive without the contents of its layers: first a tar header for each layer, then the small members."""

    data: bytes
    manifests: tuple[StoredManifest, ...]

    @property
    def hex(self) -> str:
        """The SHA-256 of the data."""
        return hashlib.sha256(self.data).hexdigest()


def skeleton(
    images: Sequence[TargetImage], *, blobs: Mapping[str, Blob], sent: Sequence[Blob], incoming: bool = True
) -> ArchiveSkeleton:
    """The skeleton of an archive of ``images`` that contains the layers ``sent``.

    With ``incoming``, Docker loads them under their private names, else under those that releases use.

    ``blobs`` maps diff IDs to the bytes by which a layer is known. A layer without a blob is already in a classic store,
    which knows it by its diff ID.
    """
    buffer = io.BytesIO(b"".join(_header(f"blobs/sha256/{blob.hex}", blob.size) for blob in sent))
    buffer.seek(0, io.SEEK_END)
    manifests = []
    index, listing = [], []
    for image in images:
        config = _add(buffer, image.config)
        manifest = manifest_of(image, blobs)
        offset = buffer.tell() + BLOCK
        digest = _add(buffer, manifest)
        ids = (f"sha256:{config}", f"sha256:{digest}")
        manifests.append(StoredManifest(image=image, ids=ids, offset=offset, length=len(manifest)))
        loaded_as = image.incoming if incoming else image.name
        index.append(_entry(image, loaded_as, digest=digest, size=len(manifest)))
        named = (blobs[one].digest if one in blobs else one for one in image.diff_ids)
        paths = [f"blobs/sha256/{digest.removeprefix('sha256:')}" for digest in named]
        listing.append({"Config": f"blobs/sha256/{config}", "RepoTags": [loaded_as], "Layers": paths})
    _add(buffer, _json({"schemaVersion": 2, "mediaType": INDEX, "manifests": index}), "index.json")
    _add(buffer, _json({"imageLayoutVersion": "1.0.0"}), "oci-layout")
    _add(buffer, _json(listing), "manifest.json")
    return ArchiveSkeleton(data=buffer.getvalue(), manifests=tuple(manifests))


def manifest_of(image: TargetImage, blobs: Mapping[str, Blob]) -> bytes:
    """The manifest of an image; ``blobs`` as in `skeleton`. Its digest is the image's ID in a containerd store."""
    layers = [_descriptor(diff_id, blobs.get(diff_id)) for diff_id in image.diff_ids]
    described = {
        "mediaType": CONFIG,
        "digest": f"sha256:{hashlib.sha256(image.config).hexdigest()}",
        "size": len(image.config),
    }
    return _json({"schemaVersion": 2, "mediaType": MANIFEST, "config": described, "layers": layers})


def _descriptor(diff_id: str, blob: Blob | None) -> dict[str, object]:
    if blob is None:
        return {"mediaType": PLAIN, "digest": diff_id, "size": 0}
    return {"mediaType": blob.media_type, "digest": blob.digest, "size": blob.size}


def _entry(image: TargetImage, name: str, *, digest: str, size: int) -> dict[str, object]:
    """An image in the index; containerd needs the full name, with the registry that short names imply."""
    names = {
        "io.containerd.image.name": full_name(name),
        "org.opencontainers.image.ref.name": image.fingerprint,
    }
    return {"mediaType": MANIFEST, "digest": f"sha256:{digest}", "size": size, "annotations": names}


def _add(buffer: io.BytesIO, data: bytes, name: str = "") -> str:
    """Append a member and return the SHA-256 of its data. A member without a name is a blob."""
    digest = hashlib.sha256(data).hexdigest()
    buffer.write(_header(name or f"blobs/sha256/{digest}", len(data)))
    buffer.write(data + bytes(-len(data) % BLOCK))
    return digest


def _header(name: str, size: int) -> bytes:
    member = tarfile.TarInfo(name)
    member.size = size
    # The GNU format, because ustar is limited to 8 GiB; the name always fits.
    return member.tobuf(tarfile.GNU_FORMAT)


def _json(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()
