"""What is in a local image, and where do its bytes come from? The only module that imports the Docker SDK.

An image reaches robots under a name that says what it is: ``talker:fleet-3f2a9c1b5d0e``, the last part a digest of its
identity (`fleet.facts.IDENTITY`). Names of that form are never moved, so a release keeps exactly the image it was
shipped with, and nothing on a robot depends on ``latest``.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Self

from fleet.errors import DesktopError, ImageError
from fleet.plan import Bytes, ImageArchive

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable
    from types import ModuleType

    import docker

    from fleet.plan import Feed

CHUNK = 1 << 20
"""The most bytes taken from the engine at once."""

PIECE = 128 * 1024
"""The most bytes sent at once, unless the engine gives more; larger ones would cost the memory allocator more than they save."""


@dataclass(frozen=True, kw_only=True)
class Image:
    """A local image. ``reference`` finds it here; ``size`` is in bytes, uncompressed; ``identity`` see `identity`."""

    reference: str
    platform: str
    size: int
    identity: str

    @property
    def layers(self) -> tuple[str, ...]:
        """The digests of its layers' tars (diff IDs), lowest first."""
        lines = self.identity.splitlines()[1:]
        return tuple(line.removeprefix("layer ") for line in takewhile(_is_layer, lines))

    @property
    def fingerprint(self) -> str:
        """Twelve hex digits of the SHA-256 of its identity."""
        return hashlib.sha256(self.identity.encode()).hexdigest()[:12]

    @property
    def shipped_as(self) -> str:
        """The name it gets on robots."""
        return f"{repository(self.reference)}:fleet-{self.fingerprint}"


def _is_layer(line: str) -> bool:
    return line.startswith("layer ")


def repository(reference: str) -> str:
    """The part of an image reference before its tag or digest (a colon may belong to a registry's port)."""
    name = reference.partition("@")[0]
    head, colon, tag = name.rpartition(":")
    return head if colon and "/" not in tag else name


def tagged_for(reference: str, platform: str) -> str:
    """The tag a build for one platform gets here: ``talker`` for linux/arm/v7 is ``talker:latest-armv7``.

    One name can hold one platform only in Docker's classic store.
    """
    name = repository(reference)
    tag = reference.partition("@")[0][len(name) + 1 :] or "latest"
    return f"{name}:{tag}-{platform.removeprefix('linux/').replace('/', '')}"


def identity(attributes: dict[str, Any]) -> str:
    """The lines by which two images are the same, from an inspection: what `fleet.facts.IDENTITY` prints."""
    config = attributes.get("Config") or {}
    lines = [f"{attributes['Os']}/{attributes['Architecture']}"]
    lines += [f"layer {layer}" for layer in attributes["RootFS"].get("Layers") or []]
    for word, key in (("env", "Env"), ("entrypoint", "Entrypoint"), ("cmd", "Cmd")):
        lines += [f"{word} {value}" for value in config.get(key) or []]
    lines += [f"user {config.get('User') or ''}", f"directory {config.get('WorkingDir') or ''}"]
    lines += [f"volume {path}" for path in sorted(config.get("Volumes") or {})]
    lines += [f"stop {signal}" for signal in [config.get("StopSignal")] if signal]
    if check := config.get("Healthcheck"):
        times = (check.get(key, 0) for key in ("Interval", "Timeout", "StartPeriod", "Retries"))
        lines += [
            *(f"check {word}" for word in check.get("Test") or []),
            "checked {} {} {} {}".format(*times),
        ]
    return "\n".join(lines).strip()


class Store:
    """The local engine's images. Open it with ``with``: one connection to the engine for the whole of a verb."""

    def __init__(self) -> None:
        import docker  # noqa: PLC0415  takes up to 0.8 s, and most verbs do without it

        try:
            self._client = _client(docker)
        except docker.errors.DockerException as problem:
            raise DesktopError(
                f"Docker on this computer does not answer: {problem}", cure="see `docker info`"
            ) from problem
        self._errors = docker.errors
        # A classic store stages every archive on this disk first: more at once would only fill it.
        self._turns = threading.BoundedSemaphore(8)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def find(self, reference: str, platform: str) -> Image:
        """The local image of that name for that platform: as `tagged_for` names it, else under its own name.

        Raises:
            ImageError: there is none, or it was made for another platform.

        """
        wrong = ""
        for name in (tagged_for(reference, platform), reference):
            with contextlib.suppress(self._errors.ImageNotFound):
                found = self._client.images.get(name)
                made_for = _platform(found.attrs)
                if made_for == platform:
                    return Image(
                        reference=name,
                        platform=platform,
                        size=found.attrs["Size"],
                        identity=identity(found.attrs),
                    )
                wrong = f"the image {name} was made for {made_for}, and the robot runs {platform}"
        raise ImageError(
            wrong or f"there is no image {reference} for {platform} here", cure="run `fab build`"
        )

    def open(self, feed: Feed) -> Iterable[bytes]:
        """The bytes of a step's feed: an image's archive comes out of the engine as it is read."""
        if isinstance(feed, ImageArchive):
            return self.archive(feed.image, feed.reference)
        if isinstance(feed, Bytes):
            return (feed.data,)
        raise TypeError(f"{feed.label} is opened by fleet.transfer.sender")

    def export(self, image: Image) -> Generator[bytes]:
        """The image as ``docker save`` writes it, under its own name. Raises as `archive`."""
        try:
            yield from self._client.api.get_image(image.reference, chunk_size=CHUNK)
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"reading image {image.reference} from Docker failed: {problem}") from problem

    def archive(self, local: str, reference: str) -> Generator[bytes]:
        """The image ``local`` as ``docker save`` writes it, named ``reference``, in pieces of at most 1 MiB.

        Raises:
            DesktopError: the engine fails on the way.

        """
        try:
            with self._turns:
                self._client.images.get(local).tag(
                    reference
                )  # an archive carries the name it is asked for by
                yield from _gathered(self._client.api.get_image(reference, chunk_size=CHUNK))
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"reading image {reference} from Docker failed: {problem}") from problem


def _client(sdk: ModuleType) -> docker.DockerClient:
    """A client for the engine that the docker command line would use: DOCKER_HOST, else the current context."""
    make = sdk.DockerClient.from_env if os.environ.get("DOCKER_HOST") else sdk.DockerClient.from_context
    client: docker.DockerClient = make(version="auto")
    return client


def _gathered(pieces: Iterable[bytes]) -> Generator[bytes]:
    """The same bytes in pieces of up to `PIECE`: the engine's own, of 32 KiB, each take two packets of SSH."""
    held: list[bytes] = []
    size = 0
    for piece in pieces:
        if held and size + len(piece) > PIECE:
            yield b"".join(held)
            held, size = [], 0
        held.append(piece)
        size += len(piece)
    yield b"".join(held)


def _platform(attributes: dict[str, Any]) -> str:
    """Docker's name of an image's platform; every 32-bit ARM image is taken for v7 unless it says otherwise."""
    architecture = attributes["Architecture"]
    variant = attributes.get("Variant") or ("v7" if architecture == "arm" else "")
    return "/".join(filter(None, (attributes["Os"], architecture, variant if architecture == "arm" else "")))
