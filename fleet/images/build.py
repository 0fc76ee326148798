"""Which images does a stack need, and how are they made for the robots' platforms?

Images are built with BuildKit by the docker command line, so that the person's builder, cache and credentials count,
one platform at a time and tagged for it (`fleet.images.image.tagged_for`). A service without ``build:`` is pulled.

Every key of Compose's ``build:`` becomes a flag of ``docker build``, or is refused by its name before anything is built.
"""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fleet.config import compose
from fleet.config.stack import literal
from fleet.errors import ComposeError
from fleet.images.debian_base import Base
from fleet.images.emulation import desktop_platform
from fleet.images.image import tagged_for

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from fleet.config.compose import Project
    from fleet.config.stack import Service, Stack

_DEBIAN = re.compile(r"\$\{?FLEET_(BUILD_)?DEBIAN_([A-Z]+)\b")


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command on this computer, what it makes (``reference`` for ``platform``), and the bases it needs first.

    ``feed`` is its standard input: a Dockerfile that is written in the Compose file. ``pulls`` is the image that it asks
    a registry for. If no registry answers, the one that is here will do; with ``only_missing``, none is asked then.
    Commands of one ``turn`` do not run side by side: all platforms of an image that is pulled have its name in turn.
    """

    title: str
    argv: tuple[str, ...]
    reference: str
    platform: str
    bases: tuple[Base, ...] = ()
    feed: str = ""
    pulls: str = ""
    only_missing: bool = False
    turn: str = ""


def bases(project: Project, platform: str) -> dict[str, Base]:
    """Debian's base images that a project's Compose files ask for, by the variable that names each.

    ``${FLEET_DEBIAN_BOOKWORM:-debian:bookworm-slim}`` as a build argument is Debian bookworm for the robot's platform,
    also where no registry answers; ``FLEET_BUILD_DEBIAN_BOOKWORM`` the same for this computer's own platform.
    """
    texts = "".join(path.read_text(encoding="utf-8") for path in compose.sources(project))
    return {
        match[0].lstrip("${"): Base(
            suite=match[2].lower(), platform=desktop_platform() if match[1] else platform
        )
        for match in _DEBIAN.finditer(texts)
    }


def plan(
    stack: Stack,
    project: Project,
    *,
    platform: str,
    client: Sequence[str],
    needs: Iterable[Base] = (),
    flags: Sequence[str] = (),
) -> tuple[Command, ...]:
    """The commands that make every image of a stack for a platform; ``client`` is the argv of a BuildKit client.

    ``flags`` are more flags for each ``docker build``.

    Raises:
        ComposeError: a service's ``build:`` cannot be carried out as it is written.

    """
    commands: list[Command] = []
    # Services may share an image, and one of them may say how it is built.
    built = {service.image for service in stack.services.values() if service.build is not None}
    for service in stack.services.values():
        wanted = service.platform or platform
        if service.build is not None:
            commands.append(
                _Build(service, stack, project, client).command(wanted, tuple(needs), flags=tuple(flags))
            )
        elif service.image not in built:
            model = stack.model["services"][service.name]
            commands += pull(service.image, wanted, policy=str(model.get("pull_policy") or ""))
    different = {json.dumps([one.argv, one.feed]): one for one in commands}
    return tuple(different.values())


def lines(commands: Iterable[Command]) -> list[str]:
    """The commands as the text that ``--dry`` prints."""
    return [text for command in commands for text in (command.title, f"  $ {shlex.join(command.argv)}")]


_ONE = {"target": "--target", "network": "--network", "shm_size": "--shm-size", "isolation": "--isolation"}
_LISTS = {"cache_from": "--cache-from", "tags": "--tag", "ssh": "--ssh"}
_MAPPINGS = {"args": "--build-arg", "labels": "--label"}
_SWITCHES = {"no_cache": "--no-cache", "pull": "--pull"}
_BUILDX = {
    "cache_to": "--cache-to",
    "entitlements": "--allow",
    "provenance": "--provenance",
    "sbom": "--sbom",
}
_READ = {"context", "dockerfile", "dockerfile_inline", "additional_contexts", "secrets", "platforms"}
_READ |= {"extra_hosts", "ulimits"}


class _Build:
    """One service's ``build:`` on its way to a command."""

    def __init__(self, service: Service, stack: Stack, project: Project, client: Sequence[str]) -> None:
        self._service = service
        self._build: Mapping[str, Any] = service.build or {}
        self._stack = stack
        self._project = project
        self._client = client
        self._buildx = not any(word == "DOCKER_BUILDKIT=1" for word in client)

    def command(self, platform: str, needs: tuple[Base, ...], *, flags: tuple[str, ...] = ()) -> Command:
        """The command that builds it for a platform. Raises `ComposeError` for what it cannot do."""
        self._check(platform)
        reference = tagged_for(self._service.image, platform)
        inline = self._build.get("dockerfile_inline")
        where = self._where(str(self._build.get("context") or "."), inline=inline is not None)
        options = (*flags, *self._options(), *self._secrets(), *self._contexts())
        return Command(
            title=f"build {reference} for {platform}",
            argv=(*self._client, "build", "--platform", platform, "--tag", reference, *options, *where),
            reference=reference,
            platform=platform,
            bases=needs,
            feed=literal(inline) if inline else "",
        )

    def _check(self, platform: str) -> None:
        known = {*_ONE, *_LISTS, *_MAPPINGS, *_SWITCHES, *_BUILDX, *_READ}
        for key, value in self._build.items():
            if value and key not in known and not key.startswith("x-"):
                raise self._refusal(
                    key, "is not supported by fleet", "remove it, or build the image yourself"
                )
            if value and (key in _BUILDX or key == "additional_contexts") and not self._buildx:
                raise self._refusal(key, "needs Docker's buildx plugin", "install the docker-buildx package")
        platforms = self._build.get("platforms") or [platform]
        if platform not in platforms:
            raise self._refusal(
                "platforms", f"does not name the robot's platform {platform}", "add it to the list"
            )

    def _options(self) -> list[str]:
        options: list[str] = []
        for key, value in self._build.items():
            if value is None:
                continue
            if flag := _ONE.get(key):
                options += [flag, literal(str(value))]
            elif flag := _LISTS.get(key) or _BUILDX.get(key):
                values = value if isinstance(value, list) else [value]
                options += [part for one in values for part in (flag, literal(_plain(one)))]
            elif flag := _MAPPINGS.get(key):
                pairs = (f"{name}={literal(_plain(one))}" for name, one in value.items() if one is not None)
                options += [part for pair in pairs for part in (flag, pair)]
            elif (flag := _SWITCHES.get(key)) and value:
                options.append(flag)
        for host in self._build.get("extra_hosts") or ():
            options += ["--add-host", literal(str(host)).replace("=", ":", 1)]
        for name, limit in (self._build.get("ulimits") or {}).items():
            both = f"{limit['soft']}:{limit['hard']}" if isinstance(limit, dict) else str(limit)
            options += ["--ulimit", f"{name}={both}"]
        return options

    def _secrets(self) -> list[str]:
        options: list[str] = []
        for use in self._build.get("secrets") or ():
            source = use["source"]
            given = (self._stack.model.get("secrets") or {}).get(source) or {}
            name = use.get("target") or source
            if file := given.get("file"):
                options += ["--secret", f"id={name},src={self._project.here(literal(file))}"]
            elif variable := given.get("environment"):
                options += ["--secret", f"id={name},env={variable}"]
            else:
                raise self._refusal("secrets", f"names {source}, which is neither a file nor a variable", "")
        return options

    def _contexts(self) -> list[str]:
        options: list[str] = []
        for name, value in (self._build.get("additional_contexts") or {}).items():
            if str(value).startswith("service:"):
                cure = "name the image of that service: docker-image://NAME"
                raise self._refusal("additional_contexts", f"refers to {value}", cure)
            options += ["--build-context", f"{name}={self._local(literal(str(value)))}"]
        return options

    def _where(self, context: str, *, inline: bool) -> tuple[str, ...]:
        place = self._local(literal(context))
        if inline:
            return ("--file", "-", place)
        dockerfile = literal(str(self._build.get("dockerfile") or "Dockerfile"))
        if place != self._local_folder(context):  # a git repository or an address: the file is in there
            return (*(("--file", dockerfile) if dockerfile != "Dockerfile" else ()), place)
        path = self._project.here(dockerfile) if dockerfile.startswith("/") else None
        file = str(path) if path else f"{place}/{dockerfile}"
        if not _is_file(file):
            raise self._refusal(
                "dockerfile", f"names {file}, which is not there", "make it, or correct its name"
            )
        return ("--file", file, place)

    def _local(self, value: str) -> str:
        """A folder of the project as it is called here; anything else, such as a git address, as it is."""
        return self._local_folder(value) or value

    def _local_folder(self, value: str) -> str:
        return str(self._project.here(literal(value))) if value.startswith("/") else ""

    def _refusal(self, key: str, what: str, cure: str) -> ComposeError:
        location = ("services", self._service.name, "build", key)
        place = compose.where(self._project, location)
        return ComposeError(f"{place}: services.{self._service.name}.build.{key} {what}", cure=cure)


def _plain(value: object) -> str:
    """YAML's true is Python's True."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _is_file(path: str) -> bool:
    try:
        return Path(path).is_file()
    except OSError:
        return False


def pull(image: str, platform: str, *, policy: str, called: str = "") -> list[Command]:
    """What brings an image here, and gives it the name of `tagged_for`, or that of the image that is ``called`` so.

    ``policy`` is Compose's ``pull_policy``, of which "" here means to look for a newer one.
    """
    reference = tagged_for(called or image, platform)
    pull = Command(
        title=f"pull {image} for {platform}",
        argv=("docker", "pull", "--platform", platform, image),
        reference=reference,
        platform=platform,
        pulls=image,
        only_missing=policy in ("missing", "if_not_present", "build"),
        turn=image,
    )
    tag = Command(
        title=f"tag {reference}",
        argv=("docker", "tag", image, reference),
        reference=reference,
        platform=platform,
        turn=image,
    )
    return [tag] if policy == "never" else [pull, tag]
