"""What do robots run, as a standard Compose file says?"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.config import yamlfile
from fleet.errors import ComposeError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


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


def read_stack(path: Path) -> Stack:
    """Read a Compose file as far as shipping it needs; the robot's own Compose judges the rest.

    Raises:
        ComposeError: it is missing, not YAML, or a service has neither a fixed image nor a name to build one under.

    """
    cure = "`stack:` in the inventory names the Compose file"
    document = yamlfile.read(path, error=ComposeError, cure=cure)
    services = document.value.get("services")
    if not isinstance(services, dict) or not services:
        raise ComposeError(f"{path}: contains no service", cure="a stack is a Compose file with `services:`")
    images: dict[str, str] = {}
    builds: dict[str, Build] = {}
    for name, service in services.items():
        where = f"{path}:{document.line(('services', name))}: services.{name}"
        fields = service if isinstance(service, dict) else {}
        images[name] = _image_name(fields.get("image"), where=where)
        if build := fields.get("build"):
            builds[name] = _build(build, folder=path.parent, where=where)
    text = yamlfile.text(path, error=ComposeError)
    return Stack(name=_name(document.value.get("name"), path), text=text, images=images, builds=builds)


def _image_name(image: object, *, where: str) -> str:
    if not isinstance(image, str):
        cure = "add `image: NAME`, next to `build:` if the image is built here"
        raise ComposeError(f"{where}: names no image", cure=cure)
    if "$" in image:
        cure = "write the name without a variable: each release pins its own images"
        raise ComposeError(f"{where}.image: {image} contains a variable", cure=cure)
    return image


def _name(given: object, path: Path) -> str:
    """Compose's project name: ``name:``, else that of the directory; ``docker/`` says nothing, so its parent's."""
    folder = path.resolve().parent
    name = str(given or (folder.parent if folder.name == "docker" else folder).name)
    return re.sub(r"[^a-z0-9_-]", "", name.lower()).lstrip("_-") or "stack"


def _build(value: object, *, folder: Path, where: str) -> Build:
    fields = {"context": value} if isinstance(value, str) else value
    if not isinstance(fields, dict):
        raise ComposeError(f"{where}.build: is neither a path nor a mapping", cure="see Compose's `build:`")
    context = (folder / str(fields.get("context") or ".")).resolve()
    return Build(
        context=context,
        dockerfile=context / str(fields.get("dockerfile") or "Dockerfile"),
        target=str(fields.get("target") or ""),
        arguments=_arguments(fields.get("args") or {}, where=where),
    )


def _arguments(args: object, *, where: str) -> tuple[tuple[str, str], ...]:
    """Build arguments, of a mapping or a list of ``NAME=value``; one without a value is left to the Dockerfile."""
    if isinstance(args, dict):
        pairs = [(str(name), value) for name, value in args.items() if value is not None]
    elif isinstance(args, list):
        pairs = [
            (name, value) for name, equals, value in (str(pair).partition("=") for pair in args) if equals
        ]
    else:
        raise ComposeError(
            f"{where}.build.args: is neither a mapping nor a list", cure="see Compose's `build:`"
        )
    # YAML's true is Python's True.
    return tuple(
        (name, str(value).lower() if isinstance(value, bool) else str(value)) for name, value in pairs
    )
