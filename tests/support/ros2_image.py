"""A real ROS 2 for the tests: an image for linux/amd64 that stands in for ``ros:kilted-ros-core``."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path, PurePosixPath

from fleet.images import debian_base
from fleet.images.docker_cli import buildkit_client, docker_or_none

HERE = Path(__file__).parent / "ros2"
PLATFORM = "linux/amd64"
PLATFORMS = ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64")
UNUSED = (".hpp", ".h", ".idl", ".in", ".cmake")
"""Endings of files that only compilers read."""


def ensure() -> str:
    """The name of the image. Its wheels are downloaded once, and kept outside the clone."""
    recipe = b"".join(path.read_bytes() for path in sorted(HERE.iterdir()))
    digest = hashlib.sha256(recipe + Path(__file__).read_bytes()).hexdigest()[:12]
    image = f"fleettest-ros2:{digest}"
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet"
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / "fleettest-ros2.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if docker_or_none("image", "inspect", "--format", "{{.Id}}", image) is None:
            _build(image, wheels(cache))
    return image


def wheels(cache: Path) -> Path:
    """The folder of the wheels, all of them or none."""
    wanted = HERE / "requirements.txt"
    folder = cache / f"ros2-wheels-{hashlib.sha256(wanted.read_bytes()).hexdigest()[:12]}"
    if not folder.exists():
        part = folder.with_suffix(".part")
        platforms = [f"--platform={name}" for name in PLATFORMS]
        pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--quiet")
        what = ("--no-deps", "--only-binary=:all:", "--require-hashes", "--python-version=3.11", *platforms)
        command = (*pip, *what, f"--requirement={wanted}", f"--dest={part}")
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-3000:]
        part.rename(folder)
    return folder


def _build(image: str, packed: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for wheel in packed.glob("*.whl"):
            _unpack(wheel, Path(folder) / "prefix")
        for name in ("Dockerfile", "ros_entrypoint.sh"):
            shutil.copy(HERE / name, folder)
        base = debian_base.ensure("bookworm", PLATFORM, say=print)
        command = (*buildkit_client(), "build", "--platform", PLATFORM, "--tag", image)
        done = subprocess.run(
            (*command, f"--build-arg=RUN_BASE={base}", folder), capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stderr[-3000:]


def _unpack(wheel: Path, prefix: Path) -> None:
    """Put the files of a wheel where pip would: https://packaging.python.org/specifications/binary-distribution-format."""
    with zipfile.ZipFile(wheel) as archive:
        for entry in archive.infolist():
            first, *rest = PurePosixPath(entry.filename).parts
            data = first.endswith(".data")
            if entry.is_dir() or entry.filename.endswith(UNUSED) or (data and rest[0] != "data"):
                continue
            place = (
                prefix.joinpath(*rest[1:])
                if data
                else prefix / "lib/python3.11/site-packages" / entry.filename
            )
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(archive.read(entry))
