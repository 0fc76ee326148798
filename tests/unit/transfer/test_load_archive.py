from __future__ import annotations

import hashlib
import io
import json
import tarfile
from typing import TYPE_CHECKING, Any

import pytest

from fleet.images.layer import Blob
from fleet.transfer.load_archive import BLOCK, ArchiveSkeleton, StoredManifest, TargetImage, skeleton
from tests.support.handmade import Handmade, digest, layer, packed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

BASE, CODE, OTHER = layer(1), layer(2), layer(3)
ONE = Handmade(layers=(BASE, CODE))
TWO = Handmade(layers=(BASE, OTHER), reference="me/camera:1")
CONTENTS = {blob.diff_id: (blob, content) for blob, content in map(packed, (BASE, CODE, OTHER))}
BLOBS = {diff_id: blob for diff_id, (blob, _) in CONTENTS.items()}


def framed(*images: Handmade, sent: Sequence[bytes], blobs: Mapping[str, Blob] = BLOBS) -> ArchiveSkeleton:
    return skeleton(
        [image.wanted for image in images], blobs=blobs, sent=[BLOBS[digest(data)] for data in sent]
    )


def put_together(archive: ArchiveSkeleton, sent: Sequence[bytes]) -> bytes:
    """The archive, as a robot makes it of the skeleton and the packed layers, like ``receive.sh``."""
    whole = b""
    for count, data in enumerate(sent):
        content = CONTENTS[digest(data)][1]
        whole += archive.data[count * BLOCK : (count + 1) * BLOCK] + content + bytes(-len(content) % BLOCK)
    return whole + archive.data[len(sent) * BLOCK :] + bytes(2 * BLOCK)


def members(archive: bytes) -> dict[str, bytes]:
    """What Python's tarfile reads, in order; a member that comes twice would be lost here, and is refused."""
    contents: dict[str, bytes] = {}
    with tarfile.open(fileobj=io.BytesIO(archive), mode="r:") as opened:
        for member in opened:
            content = opened.extractfile(member)
            assert content is not None
            assert member.name not in contents
            contents[member.name] = content.read()
        assert archive[opened.offset :] == bytes(2 * BLOCK)  # that POSIX wants at the end, and no more
    return contents


def test_an_image_without_layers_byte_for_byte() -> None:
    """Nothing of this computer is in it: neither time nor owner; the members are padded, and the end is the robot's."""
    bare = TargetImage(name="a:b", fingerprint="0123456789ab", config=b'{"rootfs":{"diff_ids":[]}}')
    config, manifest = hashlib.sha256(bare.config).hexdigest(), made_manifest(bare.config)
    described = hashlib.sha256(manifest).hexdigest()
    index = (
        '{"schemaVersion":2,"mediaType":"application/vnd.oci.image.index.v1+json","manifests":[{"mediaType":'
        f'"application/vnd.oci.image.manifest.v1+json","digest":"sha256:{described}","size":{len(manifest)},'
        '"annotations":{"io.containerd.image.name":"docker.io/fleet/incoming:0123456789ab",'
        '"org.opencontainers.image.ref.name":"0123456789ab"}}]}'
    )
    listing = f'[{{"Config":"blobs/sha256/{config}","RepoTags":["fleet/incoming:0123456789ab"],"Layers":[]}}]'
    expected = b"".join(
        (
            *member(f"blobs/sha256/{config}", bare.config),
            *member(f"blobs/sha256/{described}", manifest),
            *member("index.json", index.encode()),
            *member("oci-layout", b'{"imageLayoutVersion":"1.0.0"}'),
            *member("manifest.json", listing.encode()),
        )
    )
    archive = skeleton([bare], blobs={}, sent=[])
    assert archive.data == expected
    assert archive.hex == hashlib.sha256(expected).hexdigest()


def made_manifest(config: bytes) -> bytes:
    text = (
        '{"schemaVersion":2,"mediaType":"application/vnd.oci.image.manifest.v1+json","config":{"mediaType":'
        f'"application/vnd.oci.image.config.v1+json","digest":"{digest(config)}","size":{len(config)}}},"layers":[]}}'
    )
    return text.encode()


def member(name: str, data: bytes) -> tuple[bytes, bytes, bytes]:
    """A header as GNU tar writes it, field by field, and the padded data."""
    fields = (
        (name, 100),
        ("0000644", 8),
        ("0000000", 8),
        ("0000000", 8),
        (f"{len(data):011o}", 12),
        ("0" * 11, 12),
    )
    head = b"".join(text.encode().ljust(size, b"\0") for text, size in fields)
    rest = (b"0" + bytes(100) + b"ustar  \0" + bytes(64) + b"\0" * 8 + b"\0" * 8).ljust(BLOCK - 156, b"\0")
    total = sum(head) + sum(rest) + 8 * ord(" ")
    return head + f"{total:06o}\0 ".encode() + rest, data, bytes(-len(data) % BLOCK)


def test_with_all_layers_it_is_an_archive_that_both_kinds_of_store_read() -> None:
    """The layers come first, under the digests of their packed bytes; an index for containerd, a list for the others."""
    whole = members(put_together(framed(ONE, sent=[BASE, CODE]), [BASE, CODE]))
    assert list(whole)[:2] == [f"blobs/sha256/{BLOBS[digest(data)].hex}" for data in (BASE, CODE)]
    assert list(whole)[-3:] == ["index.json", "oci-layout", "manifest.json"]
    for name, content in whole.items():
        assert "/" not in name or name == f"blobs/sha256/{digest(content)[7:]}"
    assert json.loads(whole["oci-layout"]) == {"imageLayoutVersion": "1.0.0"}
    oci(whole, ONE)
    docker(whole, ONE)


def oci(whole: Mapping[str, bytes], *images: Handmade) -> None:
    """Follow the index as opencontainers/image-spec says: each descriptor's digest and size are those of what it names."""

    def follow(descriptor: Mapping[str, Any]) -> bytes:
        content = whole[f"blobs/sha256/{descriptor['digest'].removeprefix('sha256:')}"]
        assert (digest(content), len(content)) == (descriptor["digest"], descriptor["size"])
        return content

    index = json.loads(whole["index.json"])
    assert index["schemaVersion"] == 2
    for image, entry in zip(images, index["manifests"], strict=True):
        fingerprint = image.image.fingerprint
        assert entry["annotations"] == {
            "io.containerd.image.name": f"docker.io/fleet/incoming:{fingerprint}",
            "org.opencontainers.image.ref.name": fingerprint,
        }
        manifest = json.loads(follow(entry))
        assert manifest["mediaType"] == entry["mediaType"] == "application/vnd.oci.image.manifest.v1+json"
        assert follow(manifest["config"]) == image.config
        for data, descriptor in zip(image.layers, manifest["layers"], strict=True):
            assert descriptor["mediaType"] == "application/vnd.oci.image.layer.v1.tar+gzip"
            assert follow(descriptor) == CONTENTS[digest(data)][1]


def docker(whole: Mapping[str, bytes], *images: Handmade) -> None:
    """Follow docker's own list: configuration and layers are where it says."""
    for image, entry in zip(images, json.loads(whole["manifest.json"]), strict=True):
        assert whole[entry["Config"]] == image.config
        assert entry["RepoTags"] == [f"fleet/incoming:{image.image.fingerprint}"]
        assert [whole[path] for path in entry["Layers"]] == [
            CONTENTS[digest(data)][1] for data in image.layers
        ]


def test_layers_that_are_left_out_are_named_all_the_same() -> None:
    """By the blob that the robot is known to hold: then only the small members and what is new are in it."""
    archive = framed(ONE, sent=[CODE])
    whole = members(put_together(archive, [CODE]))
    assert len(whole) == 6
    (entry,) = json.loads(whole["manifest.json"])
    assert entry["Layers"] == [f"blobs/sha256/{BLOBS[one].hex}" for one in ONE.diff_ids]
    manifest = json.loads(archive.data[archive.manifests[0].offset :][: archive.manifests[0].length])
    assert [one["digest"] for one in manifest["layers"]] == [BLOBS[one].digest for one in ONE.diff_ids]


def test_a_layer_that_a_classic_store_has_is_named_by_its_diff_id() -> None:
    """Of its bytes nothing is known, and that store asks for nothing else."""
    known = {ONE.diff_ids[1]: BLOBS[ONE.diff_ids[1]]}
    whole = members(put_together(framed(ONE, sent=[CODE], blobs=known), [CODE]))
    (entry,) = json.loads(whole["manifest.json"])
    assert entry["Layers"][0] == f"blobs/sha256/{ONE.diff_ids[0].removeprefix('sha256:')}"


def test_images_that_share_layers() -> None:
    """Each layer is there once, whoever has it; both images are listed, both are followed to their layers."""
    whole = members(put_together(framed(ONE, TWO, sent=[BASE, CODE, OTHER]), [BASE, CODE, OTHER]))
    assert len(whole) == 3 + 2 * 2 + 3
    oci(whole, ONE, TWO)
    docker(whole, ONE, TWO)


def test_a_layer_that_an_image_has_twice() -> None:
    """It is sent once and named twice."""
    twice = Handmade(layers=(BASE, CODE, BASE))
    whole = members(put_together(framed(twice, sent=[BASE, CODE]), [BASE, CODE]))
    oci(whole, twice)
    docker(whole, twice)


def test_two_images_of_one_configuration() -> None:
    """Called differently, they are one blob: an archive that holds it twice is still read."""
    other = Handmade(layers=ONE.layers, reference="other:1")
    archive = framed(ONE, other, sent=[BASE, CODE])
    with tarfile.open(fileobj=io.BytesIO(put_together(archive, [BASE, CODE])), mode="r:") as opened:
        assert len(opened.getnames()) == 2 + 2 * 2 + 3


def test_the_ids_of_an_image_and_the_place_of_its_manifest_are_known() -> None:
    """A classic store names it by its configuration, containerd by the manifest, whose bytes are in the skeleton."""
    archive = framed(ONE, TWO, sent=[BASE, CODE, OTHER])
    for stored, image in zip(archive.manifests, (ONE, TWO), strict=True):
        content = archive.data[stored.offset :][: stored.length]
        assert stored == StoredManifest(
            image=image.wanted,
            ids=(digest(image.config), digest(content)),
            offset=stored.offset,
            length=len(content),
        )
        assert [one["digest"] for one in json.loads(content)["layers"]] == [
            BLOBS[one].digest for one in image.diff_ids
        ]


@pytest.mark.parametrize("size", [511, 512, 513])
def test_members_fill_whole_blocks(size: int) -> None:
    """One that is a whole block already is followed by the next header at once."""
    text = b'{"rootfs":{"diff_ids":[]}}'
    archive = skeleton(
        [TargetImage(name="a:b", fingerprint="f" * 12, config=text.ljust(size))], blobs={}, sent=[]
    )
    assert archive.data[BLOCK + (size + BLOCK - 1) // BLOCK * BLOCK :].startswith(b"blobs/sha256/")


def test_the_same_images_make_the_same_bytes() -> None:
    """A desktop that resumes an interrupted transfer makes the same skeleton."""
    assert framed(ONE, TWO, sent=[BASE, CODE]) == framed(ONE, TWO, sent=[BASE, CODE])
    assert framed(ONE, TWO, sent=[BASE, CODE]).hex != framed(TWO, ONE, sent=[BASE, CODE]).hex


@pytest.mark.parametrize("size", [0, 1, 8**11 - 1, 8**11, 200_000_000_000])
def test_layers_of_any_size_have_a_header(size: int) -> None:
    """From 8 GiB on the octal digits of ustar are not enough."""
    big = Blob(diff_id="sha256:a", digest=f"sha256:{'a' * 64}", size=size, media_type="")
    head = skeleton([], blobs={}, sent=[big]).data[:BLOCK]
    read = tarfile.TarInfo.frombuf(head, "utf-8", "strict")
    assert (read.name, read.size, read.type) == (f"blobs/sha256/{'a' * 64}", size, tarfile.REGTYPE)


def test_what_an_image_is_called_before_it_is_proved_and_what_it_is_made_of() -> None:
    """The name is private, and says which one it is."""
    assert ONE.wanted.incoming == f"fleet/incoming:{ONE.image.fingerprint}"
    assert ONE.wanted.diff_ids == ONE.image.layers == ONE.diff_ids
