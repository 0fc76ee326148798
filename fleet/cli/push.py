"""Which verb puts images into a registry, for others? ``fab push``."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from fleet.cli.console import Screen
from fleet.cli.registry_access import address, certificates, login_of
from fleet.cli.selection import select
from fleet.cli.stacks import Stacks, warnings_of
from fleet.cli.verb import verb
from fleet.config.image_reference import one_image, tag
from fleet.errors import UsageError
from fleet.images.store import Store
from fleet.transfer import layer_cache, pull
from fleet.transfer.layer_cache import LayerCache
from fleet.transfer.load_archive import TargetImage
from fleet.transfer.registry_push import Registries
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from fleet.cli.console import AnyProgress
    from fleet.cli.stacks import RobotStack
    from fleet.config.inventory import Robot
    from fleet.config.registry import Registry
    from fleet.images.image import Image
    from fleet.plan.step import Pulled

    Wanted = dict[str, dict[str, Image]]

_LINE = "push"
"""The name of the line of progress."""


class Pushed(NamedTuple):
    """An image in a registry: its name there with the digest, its platforms, and the bytes of layers that were pushed."""

    image: str
    platforms: tuple[str, ...]
    bytes: int


@verb({"to": "registry and path, such as registry.local:5000/robots; default: `registry:` of the robots"})
def push(
    hosts: str = "all",
    to: str = "",
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
    stack: str = "",
) -> None:
    """Push the stacks' images to a registry, for others.

    Each has its own name and tag there, for all of the robots' platforms, and is printed with its digest: `image:` of
    another project's Compose file takes it as it is. Only layers that the registry lacks are pushed. `fab ship` does not
    need this: what robots with `transport: registry` pull, it pushes by itself.
    """
    robots, screen = select(inventory, hosts)[1], Screen()
    registry = _registry(robots, to)
    with screen.progress() as progress, Stacks() as stacks, Store() as store:
        found = stacks.of(robots, only=stack)
        screen.warnings(warnings_of(found))
        cache = LayerCache(directory=layer_cache.folder(), export=store.export, pushed=store.pushed)
        registries = Registries(open_blob=cache.open, logins=login_of)
        results = []
        for reference, images in _wanted(robots, found, store).items():
            packed = [_packed(image, cache, registry, progress) for image in images.values()]
            size = sum(blob.size for blob in registries.lacks(registry, packed))
            name, digest = f"{registry.host}/{packed[0].path}:{tag(reference)}", ""
            if not dry:
                progress.step_started(_LINE, f"push {name}", None)
                size = registries.push(registry, packed)
                digest = f"@{registries.push_index(registry, packed, tag(reference))}"
            results.append(Pushed(f"{name}{digest}", tuple(images), size))
        progress.ended(_LINE)
    _show(results, screen, dry=dry, json=json)


def _show(results: Sequence[Pushed], screen: Screen, *, dry: bool, json: bool) -> None:
    if json:
        screen.json([one._asdict() for one in results])
        return
    verb_ = "would push" if dry else "pushed"
    for one in results:
        size = human_bytes(one.bytes) if one.bytes else "nothing, its layers were there already"
        screen.lines([f"{one.image} ({', '.join(one.platforms)}): {verb_} {size}"])
    if dry:
        screen.say("nothing was pushed (--dry)")


def _registry(robots: Sequence[Robot], to: str) -> Registry:
    """The registry of ``to``, with the certificates of the inventory if it has some for that host; or else the robots' own."""
    from fleet.config.registry import Registry  # noqa: PLC0415  it loads pydantic, and `fab --list` does without

    known = {robot.registry.address: robot.registry for robot in robots if robot.registry}
    if not to and len(known) == 1:
        (registry,) = known.values()
    elif not to:
        which = f"the robots have several: {', '.join(known)}" if known else "the robots have none"
        raise UsageError(f"which registry? {which}", cure="fab push --to registry.local:5000/robots")
    else:
        host = address(to).partition("/")[0]
        same = next((one for one in known.values() if one.host == host), Registry(address=to))
        registry = same.model_copy(update={"address": to})
    certificates(registry)  # so that a missing file is told before anything is packed
    return registry


def _wanted(robots: Sequence[Robot], found: Mapping[str, Sequence[RobotStack]], store: Store) -> Wanted:
    """The images by their names in the Compose files, and by platform."""
    wanted: Wanted = {}
    for robot in robots:
        for one in found[robot.name]:
            for service in one.stack.services.values():
                image = store.find(service.image, service.platform or robot.platform)
                wanted.setdefault(one_image(service.image), {})[image.platform] = image
    return wanted


def _packed(image: Image, cache: LayerCache, registry: Registry, progress: AnyProgress) -> Pulled:
    """An image with its layers packed as every Docker reads them."""
    progress.step_started(_LINE, f"pack {image.reference}", None)
    blobs = cache.pack(image, dict.fromkeys(image.layers), "gzip")
    target = TargetImage(name=image.shipped_as, fingerprint=image.fingerprint, config=cache.config(image))
    return pull.described(image, target, blobs, registry=registry)


VERBS = (push,)
