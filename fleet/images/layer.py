"""A layer of an image, as stores and archives name it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


PLAIN = "application/vnd.oci.image.layer.v1.tar"
"""The media type of a layer's tar; compressed ones append to it (opencontainers/image-spec, layer.md)."""


@dataclass(frozen=True, kw_only=True)
class Blob:
    """A layer as it travels and as a containerd store keeps it.

    ``diff_id`` is the digest of its tar, ``digest`` that of these bytes (``sha256:...``), ``size`` their number.
    ``media_type`` is OCI's. ``unpacked`` is the size of the tar in bytes, 0 if it is unknown.
    """

    diff_id: str
    digest: str
    size: int
    media_type: str
    unpacked: int = 0

    @classmethod
    def plain(cls, diff_id: str, size: int) -> Blob:
        """A layer's tar, not compressed."""
        return cls(diff_id=diff_id, digest=diff_id, size=size, media_type=PLAIN, unpacked=size)

    @property
    def hex(self) -> str:
        """The digest without its algorithm."""
        return self.digest.removeprefix("sha256:")


def chain_id(diff_ids: Sequence[str]) -> str:
    """The name of a chain of layers, lowest first, in a classic store (opencontainers/image-spec, config.md)."""
    chain = diff_ids[0]
    for diff_id in diff_ids[1:]:
        chain = f"sha256:{hashlib.sha256(f'{chain} {diff_id}'.encode()).hexdigest()}"
    return chain


def common_prefix(one: Sequence[str], other: Sequence[str]) -> int:
    """The length of the common prefix of two sequences."""
    pairs = zip(one, other, strict=False)
    return next((count for count, (a, b) in enumerate(pairs) if a != b), min(len(one), len(other)))
