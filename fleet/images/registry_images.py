"""Which images of a stack come from a registry, as ``fab ship --from REGISTRY/NAME@sha256:...`` names them? Without effects.

Here such an image is called like one that was built: ``talker:sha256-3f2a9c1b5d0e-arm64``, after the name in the Compose file,
so its releases are those of an image that was built here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.config.image_reference import full_name, is_reference, path, repository
from fleet.errors import UsageError
from fleet.images import build

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from fleet.images.build import Command

_CURE = "copy it from what `fab push` printed: registry.local:5000/robots/talker:latest@sha256:..."


def meant(text: str) -> bool:
    """Whether ``--from`` names images of a registry, and not a bundle."""
    return "@sha256:" in text


def parse(text: str) -> tuple[str, ...]:
    """The images of ``--from``, which are separated by commas. Raises `UsageError` if one is not named by its digest."""
    names = tuple(name.strip() for name in text.split(","))
    for name in names:
        if not is_reference(name) or "@sha256:" not in name or full_name(name) != name:
            raise UsageError(f"--from {name} is not an image of a registry with its digest", cure=_CURE)
    return names


def pins(names: Iterable[str], *, wanted: Collection[str]) -> dict[str, str]:
    """Which of the registry's images stands for which of those that Compose files name (``wanted``).

    Raises:
        UsageError: one stands for none of them, or two for the same.

    """
    found: dict[str, str] = {}
    for name in names:
        there = f"/{repository(name)}"
        fits = {one for one in wanted if there.endswith(f"/{path(one)}")}
        longest = max(map(len, map(path, fits)), default=0)
        fits = {one for one in fits if len(path(one)) == longest}
        if not fits:
            known = ", ".join(sorted({repository(one) for one in wanted}))
            raise UsageError(f"no stack of these robots has the image {name}", cure=f"they have: {known}")
        if twice := sorted(fits & found.keys()):
            raise UsageError(f"--from names two images for {twice[0]}: {found[twice[0]]} and {name}")
        found |= dict.fromkeys(fits, name)
    return found


def local(wanted: str, name: str) -> str:
    """What stands here for the image ``wanted`` of a Compose file, if it comes from the registry's image ``name``."""
    return f"{repository(wanted)}@{name.rpartition('@')[2]}"


def commands(pins: Mapping[str, str], platforms: Mapping[str, Collection[str]]) -> tuple[Command, ...]:
    """The commands that bring the images here, for the ``platforms`` on which each is wanted."""
    return tuple(
        command
        for wanted, name in pins.items()
        for platform in sorted(platforms[wanted])
        for command in build.pull(name, platform, policy="missing", called=local(wanted, name))
    )
