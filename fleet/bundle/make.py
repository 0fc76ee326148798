"""What does a bundle consist of? From releases and packed images to an index and the files of the bundle."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING

from fleet import onboard
from fleet.bundle import index
from fleet.bundle.index import Bundle, BundledImage, BundledRobot, BundledStack
from fleet.bundle.write import Piece, parts, piece
from fleet.config.compose import HOME
from fleet.plan import claims, hardware
from fleet.transfer import load_archive
from fleet.transfer.load_archive import TargetImage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from fleet.config.inventory import Robot
    from fleet.images.image import Image
    from fleet.images.layer import Blob
    from fleet.robot.release import Release

PROGRAMS = ("detach.sh", "prove_image.sh", "receive.sh", "swap.sh", "unpack_release.sh")
"""The scripts that ``install`` runs: those that `fab ship` runs over SSH."""

_READ_ME = """\
Software for these robots: {robots}
Made {made} by {by} with `fab bundle` of fleet.

On the robot, as the user that fab logs in as, without any network:

    sudo mount /dev/sda1 /mnt      if the system has not mounted the stick
    sh /mnt/install

It loads what the robot does not have, starts it, and goes back if it does not run. `sh /mnt/install --help` explains more.
`sha256sum -c SHA256SUMS` in this folder checks every file.
The releases hold the robots' settings and secrets in plain text: keep this stick as you keep a key.
"""


@dataclass(frozen=True, kw_only=True)
class PackedImage:
    """An image with its configuration, byte for byte, and its layers by diff ID, packed with `index.ENCODING`."""

    image: Image
    config: bytes
    layers: Mapping[str, Blob]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A release for a robot, and its stack's seconds."""

    release: Release
    wait: int
    settle: int


@dataclass(frozen=True, kw_only=True)
class Member:
    """A robot of a bundle: its releases, and its recorded host keys (type, base64)."""

    robot: Robot
    entries: Sequence[Entry]
    keys: tuple[tuple[str, str], ...] = ()


def make(
    members: Sequence[Member],
    images: Iterable[PackedImage],
    *,
    open_layer: Callable[[str], IO[bytes]],
    made: str,
    by: str,
) -> tuple[Bundle, list[Piece]]:
    """The index of a bundle, and all of its files. ``open_layer`` opens the packed bytes of a digest (hex)."""
    bundled = [_image(one) for one in images]
    layers = {blob.diff_id: blob for one in images for blob in one.layers.values()}
    archives = {id(entry): piece("", entry.release.archive(HOME)) for one in members for entry in one.entries}
    bundle = Bundle(
        made=made,
        by=by,
        robots=tuple(_robot(one, archives) for one in members),
        images={one.image.shipped_as: one for one, _ in bundled},
        layers=layers,
    )
    programs = [(name, onboard.text(name).encode()) for name in PROGRAMS]
    folder = f"programs-{hashlib.sha256(b''.join(data for _, data in programs)).hexdigest()[:12]}"
    written = index.text(bundle).encode()
    read_me = _READ_ME.format(robots=", ".join(one.robot.name for one in members), made=made, by=by)
    return bundle, [
        *(part for blob in layers.values() for part in _layer(blob, open_layer)),
        *(data for _, data in bundled),
        *(_moved(one, f"releases/{one.digest}") for one in archives.values()),
        *(piece(f"{folder}/{name}", data) for name, data in programs),
        piece(f"index-{hashlib.sha256(written).hexdigest()[:12]}", written),
        piece("install", onboard.source("install.sh").encode()),
        piece("READ-ME.txt", read_me.encode()),
    ]


def _image(packed: PackedImage) -> tuple[BundledImage, Piece]:
    """An image's line of the index, and its file: the headers of all its layers, configuration and manifest."""
    image = packed.image
    target = TargetImage(name=image.shipped_as, fingerprint=image.fingerprint, config=packed.config)
    blobs = {diff_id: packed.layers[diff_id] for diff_id in image.layers}
    members = tuple({blob.digest: blob for blob in blobs.values()}.values())
    skeleton = load_archive.skeleton([target], blobs=blobs, sent=members)
    (manifest,) = skeleton.manifests
    one = BundledImage(
        image=image, file=skeleton.hex, ids=manifest.ids, offset=manifest.offset, length=manifest.length
    )
    return one, piece(f"images/{skeleton.hex}", skeleton.data)


def _layer(blob: Blob, open_layer: Callable[[str], IO[bytes]]) -> list[Piece]:
    return parts(f"layers/{blob.hex}", size=blob.size, digest=blob.hex, source=lambda: open_layer(blob.hex))


def _robot(one: Member, archives: Mapping[int, Piece]) -> BundledRobot:
    robot = one.robot
    return BundledRobot(
        name=robot.name,
        platform=robot.platform,
        address=robot.address,
        user=robot.user or "",
        keys=one.keys,
        stacks=tuple(
            BundledStack(
                name=entry.release.stack,
                release=entry.release.id,
                file=archives[id(entry)].digest,
                wait=entry.wait,
                settle=entry.settle,
                images=tuple(image.shipped_as for image in entry.release.images),
                wants=_wants(robot, entry.release),
            )
            for entry in one.entries
        ),
    )


def _wants(robot: Robot, release: Release) -> tuple[tuple[str, str], ...]:
    """What `plan.hardware` and `plan.claims` compare with facts, as far as a few lines of shell can."""
    services = json.loads(release.compose)["services"].values()
    devices = [*robot.hardware.devices, *(path for one in services for path in hardware.devices(one))]
    # A port of one address only clashes with those of that address: Docker says that.
    ports = [port for one in services for port in claims.published(one) if not port.address]
    found = [
        *(("device", path) for path in devices if path.startswith("/dev/") and path.split() == [path]),
        *(("port", f"{port.number}/{port.protocol}") for port in ports),
        *(("name", one["container_name"]) for one in services if one.get("container_name")),
    ]
    return tuple(dict.fromkeys(found))


def _moved(one: Piece, path: str) -> Piece:
    return Piece(path=path, size=one.size, digest=one.digest, open=one.open)
