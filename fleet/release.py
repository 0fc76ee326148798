"""What exactly should this robot run? A release: the stack, the exact images, this robot's environment and files.

On the robot it is a directory that works by hand (``docker compose up -d`` in it): the person's ``compose.yaml`` as it
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

from fleet import ros, yamlfile
from fleet.errors import ComposeError, InventoryError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from fleet.image import Image
    from fleet.inventory import Robot


@dataclass(frozen=True, kw_only=True)
class Stack:
    """What robots run, as read from a standard Compose file.

    ``images`` maps each service to the image it names; ``builds`` holds the services that say how theirs is built,
    each with its context, Dockerfile, target and arguments.
    """

    name: str
    text: str
    images: Mapping[str, str]
    builds: Mapping[str, Build]


@dataclass(frozen=True, kw_only=True)
class Build:
    """How a service's image is built, as its Compose file says (``build:``), with absolute paths."""

    context: Path
    dockerfile: Path
    target: str = ""
    arguments: tuple[tuple[str, str], ...] = ()


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
        """What `fleet.facts.probe` says of the directory of this release while all of its files are right."""
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
                # .env may hold what only the robot's login should read; bind-mounted files are read by containers.
                entry.size, entry.mode = len(data), 0o600 if name == ".env" else 0o644
                archive.addfile(entry, io.BytesIO(data))
            end = archive.offset + 2 * tarfile.BLOCKSIZE
        return buffer.getvalue()[:end]  # Python fills it up to 10 kB, for tapes


def read_stack(path: Path) -> Stack:
    """Read a Compose file as far as shipping it needs; the robot's own Compose judges the rest.

    Raises:
        ComposeError: it is missing, not YAML, or a service has neither a fixed image nor a name to build one under.

    """
    cure = "`stack:` in the inventory names the Compose file"
    document = yamlfile.read(path, error=ComposeError, cure=cure)
    services = document.value.get("services")
    if not isinstance(services, dict) or not services:
        raise ComposeError(
            f"{path}: there is no service in it", cure="a stack is a Compose file with `services:`"
        )
    images: dict[str, str] = {}
    builds: dict[str, Build] = {}
    for name, service in services.items():
        where = f"{path}:{document.line(('services', name))}: services.{name}"
        said = service if isinstance(service, dict) else {}
        images[name] = _image_name(said.get("image"), where=where)
        if build := said.get("build"):
            builds[name] = _build(build, folder=path.parent, where=where)
    text = yamlfile.text(path, error=ComposeError)
    return Stack(name=_name(document.value.get("name"), path), text=text, images=images, builds=builds)


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


def _image_name(said: object, *, where: str) -> str:
    if not isinstance(said, str):
        cure = "robots are sent images by name: add `image: NAME`, next to `build:` if it is built here"
        raise ComposeError(f"{where}: names no image", cure=cure)
    if "$" in said:
        cure = "write the plain name: every release pins its images by itself"
        raise ComposeError(f"{where}.image: {said} holds a variable", cure=cure)
    return said


def _name(said: object, path: Path) -> str:
    """Compose's project name: ``name:``, else that of the directory; ``docker/`` says nothing, so its parent's."""
    folder = path.resolve().parent
    name = str(said or (folder.parent if folder.name == "docker" else folder).name)
    return re.sub(r"[^a-z0-9_-]", "", name.lower()).lstrip("_-") or "stack"


def _build(value: object, *, folder: Path, where: str) -> Build:
    said = {"context": value} if isinstance(value, str) else value
    if not isinstance(said, dict):
        raise ComposeError(f"{where}.build: is neither a path nor a mapping", cure="see Compose's `build:`")
    context = (folder / str(said.get("context") or ".")).resolve()
    return Build(
        context=context,
        dockerfile=context / str(said.get("dockerfile") or "Dockerfile"),
        target=str(said.get("target") or ""),
        arguments=_arguments(said.get("args") or {}, where=where),
    )


def _arguments(said: object, *, where: str) -> tuple[tuple[str, str], ...]:
    """Build arguments, of a mapping or a list of ``NAME=value``; one without a value is left to the Dockerfile."""
    if isinstance(said, dict):
        pairs = [(str(name), value) for name, value in said.items() if value is not None]
    elif isinstance(said, list):
        pairs = [
            (name, value) for name, equals, value in (str(pair).partition("=") for pair in said) if equals
        ]
    else:
        raise ComposeError(
            f"{where}.build.args: is neither a mapping nor a list", cure="see Compose's `build:`"
        )
    # YAML's true is Python's True.
    return tuple(
        (name, str(value).lower() if isinstance(value, bool) else str(value)) for name, value in pairs
    )
