"""What is a local image, and what is it called here and on robots?

On robots an image has a name that is derived from its content: ``talker:fleet-3f2a9c1b5d0e``, the last part a digest of its
identity (`fleet.images.identity.IDENTITY`). A name of that form never moves to another image, so a release keeps exactly the
image it was shipped with, and nothing on a robot depends on ``latest``.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from itertools import takewhile


@dataclass(frozen=True, kw_only=True)
class Image:
    """A local image. ``reference`` finds it here; ``size`` is in bytes, uncompressed; ``identity`` see `identity`."""

    reference: str
    platform: str
    size: int
    identity: str

    @property
    def layers(self) -> tuple[str, ...]:
        """The digests of its layers' tars (diff IDs), lowest first."""
        lines = self.identity.splitlines()[1:]
        return tuple(line.removeprefix("layer ") for line in takewhile(_is_layer, lines))

    @property
    def fingerprint(self) -> str:
        """Twelve hex digits of the SHA-256 of its identity."""
        return hashlib.sha256(self.identity.encode()).hexdigest()[:12]

    @property
    def shipped_as(self) -> str:
        """Its name on robots."""
        return f"{repository(self.reference)}:fleet-{self.fingerprint}"


def _is_layer(line: str) -> bool:
    return line.startswith("layer ")


def repository(reference: str) -> str:
    """The part of an image reference before its tag or digest (a colon may belong to a registry's port)."""
    name = reference.partition("@")[0]
    head, colon, tag = name.rpartition(":")
    return head if colon and "/" not in tag else name


def tagged_for(reference: str, platform: str) -> str:
    """The tag of a build for one platform on this computer: ``talker`` for linux/arm/v7 is ``talker:latest-armv7``.

    In Docker's classic store, a name can hold only one platform.
    """
    name = repository(reference)
    tag = reference.partition("@")[0][len(name) + 1 :] or "latest"
    return f"{name}:{tag}-{platform.removeprefix('linux/').replace('/', '')}"
