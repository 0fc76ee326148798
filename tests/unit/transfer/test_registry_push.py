from __future__ import annotations

import io
import json
from typing import IO

from fleet.config.registry import Registry
from fleet.plan.step import Pulled
from fleet.transfer import load_archive
from fleet.transfer.registry_push import Registries, index_of
from tests.support.handmade import Handmade, layer, packed
from tests.support.registry import TestRegistry

BASE, CODE = layer(1), layer(2)
CONTENTS = {blob.hex: content for blob, content in map(packed, (BASE, CODE))}
SIZES = {data: packed(data)[0].size for data in (BASE, CODE)}


def described(*layers: bytes) -> Pulled:
    image = Handmade(layers=layers)
    blobs = {blob.diff_id: blob for blob, _ in map(packed, layers)}
    return Pulled(
        name=image.image.shipped_as,
        path="robots/talker",
        manifest=load_archive.manifest_of(image.wanted, blobs),
        config=image.config,
        blobs=tuple(blobs.values()),
    )


def opened(digest: str) -> IO[bytes]:
    return io.BytesIO(CONTENTS[digest])


OLD, NEW = described(BASE), described(BASE, CODE)


def test_each_layer_is_pushed_once() -> None:
    """For all robots of a run; and in the next run only what is new."""
    with TestRegistry() as there:
        registry = Registry(address=f"127.0.0.1:{there.port}/robots")
        first = Registries(open_blob=opened, logins=lambda _: None)
        assert [blob.size for blob in first.lacks(registry, [OLD])] == [SIZES[BASE]]
        assert there.blobs == {}
        assert first.push(registry, [OLD]) == SIZES[BASE]
        count = len(there.asked)
        assert first.push(registry, [OLD]) == 0
        assert len(there.asked) == count
        second = Registries(open_blob=opened, logins=lambda _: None)
        assert second.push(registry, [OLD, NEW]) == SIZES[CODE]
        assert there.manifests["robots/talker", NEW.tag] == NEW.manifest
        assert there.manifests["robots/talker", NEW.digest] == NEW.manifest
        assert there.blobs[NEW.identity] == NEW.config
        assert second.docker_config(registry, [NEW]) == ""


def test_a_tag_is_one_image_or_one_for_each_platform() -> None:
    """Docker chooses by the platform in the index."""
    with TestRegistry() as there:
        registry = Registry(address=f"127.0.0.1:{there.port}/robots")
        one = Registries(open_blob=opened, logins=lambda _: None)
        one.push(registry, [OLD, NEW])
        assert one.push_index(registry, [NEW], "latest") == NEW.digest
        assert there.manifests["robots/talker", "latest"] == NEW.manifest
        digest = one.push_index(registry, [OLD, NEW], "latest")
        index = there.manifests["robots/talker", digest]
        assert index == there.manifests["robots/talker", "latest"] == index_of([OLD, NEW])
    assert [(one["digest"], one["platform"]) for one in json.loads(index)["manifests"]] == [
        (one.digest, {"os": "linux", "architecture": "amd64"}) for one in (OLD, NEW)
    ]
