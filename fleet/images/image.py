"""What is a local image, and what is it called here and on robots?

An image's identity is the digest of its configuration, byte for byte (opencontainers/image-spec, config.md: "ImageID").
The configuration names everything by which an image runs, and the digests of its layers, so nothing can differ between
two images of one identity. Docker's classic store shows it as the image's ID; a containerd store shows the ID of the
manifest, which names it.

On robots an image has a name that is derived from it: ``talker:fleet-3f2a9c1b5d0e``. A name of that form never moves to
another image, so a release keeps exactly the image it was shipped with, and nothing on a robot depends on ``latest``.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fleet.config.image_reference import LONGEST_TAG, repository, tag

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


@dataclass(frozen=True, kw_only=True)
class Image:
    """A local image.

    ``reference`` finds it here; ``size`` is in bytes, uncompressed; ``identity`` is the digest of its configuration;
    ``layers`` are the digests of its layers' tars (diff IDs), lowest first. ``l4t`` is the version of NVIDIA's Linux that it
    is made for, as far as it says one.
    """

    reference: str
    platform: str
    size: int
    identity: str
    layers: tuple[str, ...] = ()
    l4t: str = ""

    @property
    def fingerprint(self) -> str:
        """The first twelve hex digits of its identity."""
        return self.identity.removeprefix("sha256:")[:12]

    @property
    def shipped_as(self) -> str:
        """Its name on robots."""
        return f"{repository(self.reference)}:fleet-{self.fingerprint}"


def tagged_for(reference: str, platform: str) -> str:
    """The tag of a build for one platform on this computer: ``talker`` for linux/arm/v7 is ``talker:latest-armv7``.

    In Docker's classic store, a name can hold only one platform. Images with different digests have different tags.
    """
    suffix = f"-{platform.removeprefix('linux/').replace('/', '')}"
    digest = reference.partition("@sha256:")[2]
    own = f"sha256-{digest[:12]}" if digest else tag(reference)
    if len(own) + len(suffix) > LONGEST_TAG:
        own = f"{own[:80]}-{hashlib.sha256(own.encode()).hexdigest()[:12]}"
    return f"{repository(reference)}:{own}{suffix}"


def platform(*, os: str, architecture: str, variant: str = "") -> str:
    """Docker's name of a platform.

    32-bit ARM without a variant counts as v7, and arm64 has no other variant than v8. amd64 is v1: Docker on a robot of
    linux/amd64 refuses an image for v3.
    """
    if architecture == "amd64" and variant not in ("", "v1"):
        return f"{os}/{architecture}/{variant}"
    if architecture != "arm":
        return f"{os}/{architecture}"
    return f"{os}/{architecture}/{variant or 'v7'}"


_L4T_KEYS = ("l4t_version", "l4t_major_version", "com.nvidia.l4t.version")
_L4T_VALUE = re.compile(r"[rR]?(3[0-9](?:\.[0-9]+)*)(?![0-9])")
_L4T_TAG = re.compile(r"(?<![a-z0-9])r(3[0-9](?:\.[0-9]+)+)")


def l4t(reference: str, config: Mapping[str, Any]) -> str:
    """The version of NVIDIA's Linux that an image is made for, ``36.2.0``; "" if it says none.

    There is no standard. ``config`` (the part that has Env and Labels) may have one of `_L4T_KEYS` as a variable or a label;
    NVIDIA's own images (``nvcr.io/nvidia/l4t-base:r36.2.0``) and those of jetson-containers
    (``dustynv/ros:humble-desktop-l4t-r36.4.0``) have it in the tag only.
    """
    labels, variables = config.get("Labels") or {}, config.get("Env") or ()
    said = {**labels, **dict(str(pair).partition("=")[::2] for pair in variables)}
    for key, value in said.items():
        if key.lower() in _L4T_KEYS:
            found = _L4T_VALUE.match(str(value))
            return found[1] if found else ""
    found = _L4T_TAG.search(tag(reference))
    for_jetson = re.search(r"l4t|jetson|jetpack|dustynv", reference)
    return found[1] if found and for_jetson else ""


def same_platform(one: str, other: str) -> bool:
    """Whether two names mean one platform: ``linux/arm64/v8`` and ``linux/arm64``."""
    return _normal(one) == _normal(other)


def _normal(name: str) -> str:
    os, _, rest = name.partition("/")
    architecture, _, variant = rest.partition("/")
    return platform(os=os, architecture=architecture, variant=variant)


def configuration(small: Mapping[str, bytes], wanted: str) -> bytes | None:
    """The configuration of the image for a platform, out of the small members of what ``docker save`` writes.

    ``small`` are their contents by path. None if the archive holds no image for that platform.
    """
    for data in _configurations(small):
        described = _object(data)
        names = {key: str(described.get(key) or "") for key in ("os", "architecture", "variant")}
        if same_platform(platform(**names), wanted):
            return data
    return None


def _configurations(small: Mapping[str, bytes]) -> Iterator[bytes]:
    """Those that manifest.json names (docker's own format), and those that index.json leads to (OCI image layout)."""
    listed = _json(small.get("manifest.json", b""))
    for entry in listed if isinstance(listed, list) else ():
        if isinstance(entry, dict) and str(entry.get("Config")) in small:
            yield small[str(entry["Config"])]
    waiting = [_object(small.get("index.json", b""))]
    for _ in range(1000):  # an index may name indexes
        if not waiting:
            return
        one = waiting.pop()
        if (data := _blob(small, one.get("config"))) is not None:
            yield data
        listed = one.get("manifests")
        found = (_blob(small, entry) for entry in (listed if isinstance(listed, list) else ()))
        waiting += [_object(data) for data in found if data is not None]


def _blob(small: Mapping[str, bytes], descriptor: object) -> bytes | None:
    digest = descriptor.get("digest") if isinstance(descriptor, dict) else None
    return small.get(f"blobs/{str(digest).replace(':', '/')}")


def _object(data: bytes) -> dict[str, Any]:
    value = _json(data)
    return value if isinstance(value, dict) else {}


def _json(data: bytes) -> object:
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None
