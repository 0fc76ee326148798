"""How large are the layers of local images, and how small does zstd make them?"""

from __future__ import annotations

import json
import subprocess
import tarfile
import tempfile
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING

from fleet.images.docker_cli import docker

if TYPE_CHECKING:
    from collections.abc import Sequence

ZSTD = ("zstd", "-3", "--long=27", "-T0", "--stdout", "--quiet")


@dataclass(frozen=True, kw_only=True)
class Layer:
    """One layer's bytes: as a tar, and as `ZSTD` makes of it."""

    size: int
    compressed: int


def measured(images: Sequence[str]) -> dict[str, tuple[Layer, ...]]:
    """The layers of each image, lowest first; what they share is measured once."""
    known: dict[str, Layer] = {}
    with tempfile.NamedTemporaryFile() as file:
        docker("save", "--output", file.name, *images, timeout=600)
        with tarfile.open(file.name) as archive:
            saved = json.load(_member(archive, "manifest.json"))
            for name in (name for image in saved for name in image["Layers"] if name not in known):
                known[name] = _layer(_member(archive, name))
    return {
        tag: tuple(known[name] for name in image["Layers"]) for image in saved for tag in image["RepoTags"]
    }


def _member(archive: tarfile.TarFile, name: str) -> IO[bytes]:
    found = archive.extractfile(name)
    if found is None:
        raise RuntimeError(f"docker save wrote no file {name}")
    return found


def _layer(tar: IO[bytes]) -> Layer:
    with tempfile.TemporaryFile() as small:
        with subprocess.Popen(ZSTD, stdin=subprocess.PIPE, stdout=small) as zstd:
            assert zstd.stdin
            size = 0
            while piece := tar.read(1 << 20):
                zstd.stdin.write(piece)
                size += len(piece)
            zstd.stdin.close()
        if zstd.returncode:
            raise RuntimeError(f"zstd ended with code {zstd.returncode}")
        return Layer(size=size, compressed=small.seek(0, 2))
