"""What does a registry lack of the images that robots shall pull from it, and how does it get there? Once, for all robots."""

from __future__ import annotations

import hashlib
import io
import json
import threading
from typing import IO, TYPE_CHECKING

from fleet.images.layer import Blob
from fleet.images.registry_client import RegistryClient
from fleet.transfer.load_archive import CONFIG, INDEX, MANIFEST

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from fleet.config.registry import Registry
    from fleet.images.registry_client import Login
    from fleet.plan.step import Pulled

    Logins = Callable[[Registry], Login | None]


class Registries:
    """The registries of one run. ``open_blob`` opens a layer by its digest (hex); ``logins`` finds a registry's login.

    All methods raise `NotReady` as `RegistryClient` does.
    """

    def __init__(self, *, open_blob: Callable[[str], IO[bytes]], logins: Logins) -> None:
        self._open = open_blob
        self._logins = logins
        self._clients: dict[Registry, RegistryClient] = {}
        self._there: set[tuple[str, str, str]] = set()
        self._lock = threading.Lock()  # robots of one registry wait for the first one's push

    def client(self, registry: Registry) -> RegistryClient:
        """The client of a registry."""
        return self._clients.setdefault(
            registry, RegistryClient(registry, login=lambda: self._logins(registry))
        )

    def lacks(self, registry: Registry, images: Sequence[Pulled]) -> tuple[Blob, ...]:
        """The layers that a registry does not have. Nothing is changed."""
        with self._lock:
            lacking = {
                blob.digest: blob
                for one in images
                for blob in one.blobs
                if not self._has(registry, one, blob)
            }
        return tuple(lacking.values())

    def push(self, registry: Registry, images: Iterable[Pulled]) -> int:
        """Bring images into a registry, each under a tag of its own; return the bytes of layers that were pushed."""
        with self._lock:
            return sum(self._push(registry, one) for one in images)

    def push_index(self, registry: Registry, images: Sequence[Pulled], tag: str) -> str:
        """Give images for several platforms one tag, and return the digest behind it. Of one image, it is the image's own."""
        first, *others = images
        data, media_type = (index_of(images), INDEX) if others else (first.manifest, MANIFEST)
        self.client(registry).push_manifest(first.path, tag, data, media_type)
        return f"sha256:{hashlib.sha256(data).hexdigest()}"

    def _push(self, registry: Registry, one: Pulled) -> int:
        client, pushed = self.client(registry), 0
        config = Blob(diff_id="", digest=one.identity, size=len(one.config), media_type=CONFIG)
        for blob in (*one.blobs, config):
            if not self._has(registry, one, blob):
                with io.BytesIO(one.config) if blob is config else self._open(blob.hex) as content:
                    client.push_blob(one.path, blob, content)
                self._there.add((registry.host, one.path, blob.digest))
                pushed += 0 if blob is config else blob.size
        if (registry.host, one.path, one.tag) not in self._there:
            client.push_manifest(one.path, one.tag, one.manifest, MANIFEST)
            self._there.add((registry.host, one.path, one.tag))
        return pushed

    def _has(self, registry: Registry, image: Pulled, blob: Blob) -> bool:
        key = (registry.host, image.path, blob.digest)
        if key not in self._there and self.client(registry).has(image.path, "blobs", blob.digest):
            self._there.add(key)
        return key in self._there

    def docker_config(self, registry: Registry, images: Iterable[Pulled]) -> str:
        """The config.json with which a robot may pull images; "" if it needs none."""
        return self.client(registry).docker_config(tuple(dict.fromkeys(one.path for one in images)))


def index_of(images: Iterable[Pulled]) -> bytes:
    """An index of images for several platforms (opencontainers/image-spec, image-index.md)."""
    entries = []
    for one in images:
        config = json.loads(one.config)
        platform = {key: config[key] for key in ("os", "architecture", "variant") if config.get(key)}
        entries.append(
            {"mediaType": MANIFEST, "digest": one.digest, "size": len(one.manifest), "platform": platform}
        )
    return json.dumps({"schemaVersion": 2, "mediaType": INDEX, "manifests": entries}).encode()
