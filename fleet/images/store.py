"""The images of this computer's Docker Engine. The only module that imports the Docker SDK."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import TYPE_CHECKING, Any, Self

from fleet.errors import DesktopError, ImageError

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable
    from types import ModuleType

    import docker

from fleet.images.identity import identity
from fleet.images.image import Image, tagged_for

CHUNK = 1 << 20
"""Bytes read from the engine at once, at most."""

PIECE = 128 * 1024
"""Bytes passed on at once, unless the engine gives more. Larger pieces cost the memory allocator more than they save."""


class Store:
    """The local engine's images. Open it with ``with``: one connection to the engine for the whole of a verb."""

    def __init__(self) -> None:
        import docker  # noqa: PLC0415  takes up to 0.8 s, and most verbs do not need it

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
        """The local image of that name for that platform: under the name of `tagged_for`, else under its own.

        Raises:
            ImageError: there is no such image, or it was built for another platform.

        """
        wrong = ""
        for name in (tagged_for(reference, platform), reference):
            with contextlib.suppress(self._errors.ImageNotFound):
                local = self._client.images.get(name)
                built_for = _platform(local.attrs)
                if built_for == platform:
                    return Image(
                        reference=name,
                        platform=platform,
                        size=local.attrs["Size"],
                        identity=identity(local.attrs),
                    )
                wrong = f"the image {name} was built for {built_for}, and the robot runs {platform}"
        raise ImageError(
            wrong or f"there is no image {reference} for {platform} here", cure="run `fab build`"
        )

    def export(self, image: Image) -> Generator[bytes]:
        """The image as ``docker save`` writes it, under its own name. Raises as `archive`."""
        try:
            yield from self._client.api.get_image(image.reference, chunk_size=CHUNK)
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"reading image {image.reference} from Docker failed: {problem}") from problem

    def archive(self, local: str, reference: str) -> Generator[bytes]:
        """The image ``local`` as ``docker save`` writes it, named ``reference``, in pieces of at most 1 MiB.

        Raises:
            DesktopError: the engine fails while it is read.

        """
        try:
            with self._turns:
                self._client.images.get(local).tag(
                    reference
                )  # the archive contains the name it is requested by
                yield from _gathered(self._client.api.get_image(reference, chunk_size=CHUNK))
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"reading image {reference} from Docker failed: {problem}") from problem


def _client(sdk: ModuleType) -> docker.DockerClient:
    """A client for the engine that the docker command line would use: DOCKER_HOST, else the current context."""
    make = sdk.DockerClient.from_env if os.environ.get("DOCKER_HOST") else sdk.DockerClient.from_context
    client: docker.DockerClient = make(version="auto")
    return client


def _gathered(pieces: Iterable[bytes]) -> Generator[bytes]:
    """The same bytes in pieces of up to `PIECE`: the engine's own pieces of 32 KiB take two SSH packets each."""
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
    """Docker's name of an image's platform; a 32-bit ARM image without a variant counts as v7."""
    architecture = attributes["Architecture"]
    variant = attributes.get("Variant") or ("v7" if architecture == "arm" else "")
    return "/".join(filter(None, (attributes["Os"], architecture, variant if architecture == "arm" else "")))
