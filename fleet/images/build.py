"""Which images does a stack need, and how are they built for the robots' platforms?

Images are built with BuildKit by the docker command line, so that the user's builder, cache and credentials are used,
one platform at a time and tagged for it (`fleet.images.image.tagged_for`). A service without ``build:`` is pulled.
"""

from __future__ import annotations

import re
import shlex
import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.errors import ComposeError, DesktopError
from fleet.images import debian_base
from fleet.images.debian_base import Base
from fleet.images.emulation import desktop_platform
from fleet.images.image import tagged_for

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from fleet.config.stack import Build, Stack

_DEBIAN = re.compile(
    r"^\s*(?i:ARG)\s+(\w+)=[\"']?(?:docker\.io/library/)?debian:(\w+)-slim[\"']?\s*$", re.MULTILINE
)


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command on this computer. It makes ``reference`` for ``platform``, and needs ``bases`` first."""

    title: str
    argv: tuple[str, ...]
    reference: str
    platform: str
    bases: tuple[Base, ...] = ()


def plan(*, stack: Stack, platforms: Iterable[str], client: Sequence[str]) -> tuple[Command, ...]:
    """The commands that make every image of the stack for every platform; ``client`` is the argv of a BuildKit client.

    Raises:
        ComposeError: a Dockerfile is missing.

    """
    # Services may share an image, and one of them may say how it is built.
    builds = {stack.images[service]: build for service, build in stack.builds.items()}
    commands: list[Command] = []
    for platform in dict.fromkeys(platforms):
        for image in dict.fromkeys(stack.images.values()):
            reference = tagged_for(image, platform)
            if image in builds:
                commands.append(_build(builds[image], reference, platform, client))
            else:
                commands += _pull(image, reference, platform)
    return tuple(commands)


def run(command: Command, *, say: Callable[[str], None]) -> None:
    """Run a command, its bases first. Its output goes to standard error.

    Raises:
        DesktopError: it failed.

    """
    for base in command.bases:
        debian_base.ensure(base.suite, base.platform, say=say)
    say(command.title)
    code = subprocess.run(command.argv, stdin=subprocess.DEVNULL, stdout=2, check=False).returncode
    if code:
        raise DesktopError(
            f"{command.title} failed with code {code}", cure="the reason is in the lines above"
        )


def lines(commands: Iterable[Command]) -> list[str]:
    """The commands as the text that ``--dry`` prints."""
    return [text for command in commands for text in (command.title, f"  $ {shlex.join(command.argv)}")]


def _build(build: Build, reference: str, platform: str, client: Sequence[str]) -> Command:
    bases = _bases(build, platform)
    arguments = [*build.arguments, *((name, base.tag) for name, base in bases.items())]
    options = [part for name, value in arguments for part in ("--build-arg", f"{name}={value}")]
    if build.target:
        options += ["--target", build.target]
    where = ("--file", str(build.dockerfile), str(build.context))
    return Command(
        title=f"build {reference} for {platform}",
        argv=(*client, "build", "--platform", platform, "--tag", reference, *options, *where),
        reference=reference,
        platform=platform,
        bases=tuple(bases.values()),
    )


def _bases(build: Build, platform: str) -> dict[str, Base]:
    """The Dockerfile's ``ARG NAME=debian:SUITE-slim`` lines: bases that can be had without a registry too.

    Names that begin with BUILD are for the computer that builds, the others for the robot.
    """
    given = dict(build.arguments)
    return {
        name: Base(suite=suite, platform=desktop_platform() if name.startswith("BUILD") else platform)
        for name, suite in _DEBIAN.findall(_text(build.dockerfile))
        if name not in given
    }


def _text(dockerfile: Path) -> str:
    try:
        return dockerfile.read_text(encoding="utf-8", errors="replace")
    except OSError as problem:
        cure = "`build:` in the Compose file says where it is"
        raise ComposeError(f"cannot read {dockerfile}: {problem.strerror}", cure=cure) from problem


def _pull(image: str, reference: str, platform: str) -> list[Command]:
    pull = ("docker", "pull", "--platform", platform, image)
    tag = ("docker", "tag", image, reference)
    return [
        Command(title=f"pull {image} for {platform}", argv=pull, reference=reference, platform=platform),
        Command(title=f"name it {reference}", argv=tag, reference=reference, platform=platform),
    ]
