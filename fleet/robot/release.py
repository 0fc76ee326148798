"""What exactly should this robot run? A release: the stack, the exact images, this robot's environment and files.

On the robot it is a directory that works by hand (``docker compose up -d`` in it): the user's ``compose.yaml`` as it
is, a ``compose.override.yaml`` that pins the images, ``.env`` and ``files/``. Compose reads the first three by itself.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import tarfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.errors import InventoryError
from fleet.ros import environment as ros

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.config.stack import Stack
    from fleet.images.image import Image


@dataclass(frozen=True, kw_only=True)
class Release:
    """One robot's release. ``id`` is derived from all the rest: the same content is the same release, anywhere.

    ``files`` maps paths below the release's directory to their bytes.
    """

    id: str
    stack: str
    robot: str
    services: tuple[str, ...]
    images: tuple[Image, ...]
    files: Mapping[str, bytes]

    @property
    def checksum(self) -> str:
        """The checksum that ``probe.sh`` prints for this release's directory if all of its files are right."""
        digests = {f"./{name}": hashlib.sha256(data).hexdigest() for name, data in self.files.items()}
        listing = "".join(f"{digests[name]}  {name}\n" for name in sorted(digests, key=str.encode))
        return hashlib.sha256(listing.encode()).hexdigest()

    def archive(self) -> bytes:
        """The release's directory as a tar archive; the same bytes every time."""
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w", format=tarfile.PAX_FORMAT) as archive:
            folder = tarfile.TarInfo("files")
            folder.type, folder.mode = tarfile.DIRTYPE, 0o755
            archive.addfile(folder)
            for name, data in sorted(self.files.items()):
                entry = tarfile.TarInfo(name)
                # .env may hold secrets that only the login should read; containers read the bind-mounted files.
                entry.size, entry.mode = len(data), 0o600 if name == ".env" else 0o644
                archive.addfile(entry, io.BytesIO(data))
            end = archive.offset + 2 * tarfile.BLOCKSIZE
        return buffer.getvalue()[:end]  # Python pads it to 10 kB, for tapes


def compose(*, robot: Robot, stack: Stack, find: Callable[[str, str], Image]) -> Release:
    """One robot's release; ``find`` gives the local image of a name and a platform.

    Raises:
        ImageError: from ``find``.
        InventoryError: a file to bind-mount cannot be read.

    """
    environment = {**robot.environment, **ros.environment(robot), "FLEET_ROBOT": robot.name}
    images = {service: find(name, robot.platform) for service, name in stack.images.items()}
    files = {f"files/{name}": _read(path) for name, path in robot.files.items()}
    texts = {"compose.yaml": stack.text, ".env": dotenv(dict(sorted(environment.items())))}
    content = {
        "name": stack.name,
        "texts": texts,
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in files.items()},
        "images": {service: image.fingerprint for service, image in images.items()},
    }
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
    labels = {"fleet.release": digest, "fleet.stack": stack.name, "fleet.robot": robot.name}
    texts["compose.override.yaml"] = _override(stack=stack, images=images, labels=labels)
    return Release(
        id=digest,
        stack=stack.name,
        robot=robot.name,
        services=tuple(images),
        images=tuple({image.shipped_as: image for image in images.values()}.values()),
        files={**files, **{name: text.encode() for name, text in texts.items()}},
    )


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as problem:
        raise InventoryError(
            f"cannot read {path}: {problem.strerror}", cure="see `files:` in the inventory"
        ) from problem


def dotenv(environment: Mapping[str, str]) -> str:
    """Variables as a ``.env`` file that Compose reads back exactly.

    Single quotes keep everything but a quote and a backslash before one; such values go into double quotes, with
    Compose's escapes (docs.docker.com/compose/how-tos/environment-variables/variable-interpolation, ".env file syntax").
    """
    return "".join(f"{name}={_quoted(value)}\n" for name, value in environment.items())


def _quoted(value: str) -> str:
    if re.fullmatch(r"[\w./:@%+,-]*", value, flags=re.ASCII):
        return value
    if not {"'", "\n"} & set(value) and not value.endswith("\\"):
        return f"'{value}'"
    escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("$", "\\$").replace("\n", "\\n")
    return f'"{escaped}"'


def _override(*, stack: Stack, images: Mapping[str, Image], labels: Mapping[str, str]) -> str:
    """The pins of a release. JSON is YAML, and quotes itself."""
    services = {
        name: {"image": image.shipped_as, "platform": image.platform, "labels": labels}
        for name, image in images.items()
    }
    return json.dumps({"name": stack.name, "services": services}, indent=2) + "\n"
