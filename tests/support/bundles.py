"""Bundles for tests: two robots that run one image made by hand."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import IO, TYPE_CHECKING

from fleet.bundle.make import Entry, Member, PackedImage, make
from fleet.config.compose import HOME
from fleet.config.project_files import File, ProjectFiles
from fleet.robot.release import compose
from tests.support.handmade import Handmade, layer, packed
from tests.support.samples import PI, PROJECT, STACK

if TYPE_CHECKING:
    from fleet.bundle.index import Bundle
    from fleet.bundle.write import Piece
    from fleet.config.inventory import Robot
    from fleet.robot.release import Release

MADE = "2026-11-28T12:00:00Z"
TALKER = Handmade(layers=(layer(1), layer(2)))
LAYERS = dict(map(packed, TALKER.layers))
BLOBS = {blob.hex: data for blob, data in LAYERS.items()}
IMAGE = PackedImage(image=TALKER.image, config=TALKER.config, layers={blob.diff_id: blob for blob in LAYERS})
FILES = ProjectFiles(
    files={
        "config/a.yaml": File(data=b"a"),
        "config/link": File(link="a.yaml"),
        "run": File(data=b"#!", mode=0o755),
        "nothing": File(folder=True, mode=0o755),
        "open": File(folder=True, mode=0o777),
    },
    seeds={"maps/home": File(data=b"map")},
    folders=("maps", "logs"),
)
ROBOT = PI.model_copy(update={"platform": "linux/amd64", "user": None})


def opened(digest: str) -> IO[bytes]:
    return io.BytesIO(BLOBS[digest])


def release(robot: Robot = ROBOT) -> Release:
    """With files of every kind, and a value that needs the login's home."""
    images = dict.fromkeys(STACK.services, TALKER.image)
    whole = compose(robot=robot.name, stack=STACK, project=PROJECT, files=FILES, images=images)
    return replace(whole, compose=whole.compose.replace('"image"', f'"working_dir": "{HOME}/x", "image"', 1))


def bundle(*names: str, made: str = MADE, robot: Robot = ROBOT) -> tuple[Bundle, list[Piece]]:
    """For robots of these names, else for pi1 and pi2."""
    robots = [
        robot.model_copy(update={"name": name, "address": f"{name}.local"})
        for name in names or ("pi1", "pi2")
    ]
    members = [
        Member(robot=one, entries=[Entry(release=release(one), wait=180, settle=10)]) for one in robots
    ]
    return make(members, [IMAGE], open_layer=opened, made=made, by="tim@desktop")
