"""The images of this computer's Docker Engine. The only module that imports the Docker SDK."""

from __future__ import annotations

import collections
import contextlib
import functools
import hashlib
import io
import json
import os
import tarfile
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from fleet.errors import DesktopError, ImageError

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterable, Mapping
    from types import ModuleType

    import docker

from fleet.config.image_reference import one_image
from fleet.images import image, push
from fleet.images.chunks import SMALL, Chunks, small_members
from fleet.images.image import Image, same_platform, tagged_for

CHUNK = 1 << 20
"""Bytes read from the engine at once, at most."""

PIECE = 128 * 1024
"""Bytes passed on at once, unless the engine gives more. Larger pieces cost the memory allocator more than they save."""


_LOCAL = "http+docker://localhost"
"""How the SDK calls an engine behind a socket of this computer: its loopback is ours, if it is no other's after all."""

_SAVES = 100_000_000
"""Bytes of an image per second that `docker save` gives out, staging included; a push packs a quarter of that."""

_FINISHING = 10.0
"""Seconds that a push which is not needed any more has to end."""


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
        self._names: collections.Counter[str] = collections.Counter()
        self._names_lock = threading.Lock()
        self._primer = contextlib.ExitStack()
        self._primed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._primer.close()
        with self._names_lock:  # a Ctrl-C leaves threads behind, which do not come to their end
            for name in +self._names:
                self._forget(name)
        self._client.close()

    def find(self, reference: str, platform: str) -> Image:
        """The local image of that name for that platform: under the name of `tagged_for`, else under its own.

        Raises:
            ImageError: there is no such image, it was built for another platform, or Docker refuses the name.
            DesktopError: Docker does not answer.

        """
        other = ""
        for name in (tagged_for(reference, platform), one_image(reference)):
            attributes = self._inspected(name)
            if attributes is None:
                continue
            found = self._image(name, attributes, platform)
            if same_platform(found.platform, platform):
                return found
            other = f"the image {name} was built for {found.platform}, and the robot runs {platform}"
        raise ImageError(
            other or f"there is no image {reference} for {platform} here", cure="run `fab build`"
        )

    def _inspected(self, name: str) -> dict[str, Any] | None:
        try:
            attributes: dict[str, Any] = self._client.images.get(name).attrs
        except self._errors.ImageNotFound:
            return None
        except self._errors.APIError as problem:
            raise ImageError(
                f"Docker refuses the image name {name}: {problem.explanation or problem}",
                cure="correct `image:` in the Compose file",
            ) from problem
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"asking Docker for image {name} failed: {problem}") from problem
        return attributes

    def _image(self, name: str, attributes: dict[str, Any], wanted: str) -> Image:
        """What a name holds. In a containerd store that may be images for several platforms: the ``wanted`` one, if it is there."""
        shown = image.platform(
            os=attributes["Os"],
            architecture=attributes["Architecture"],
            variant=attributes.get("Variant") or "",
        )
        identity, layers = attributes["Id"], tuple(attributes["RootFS"].get("Layers") or ())
        settings = attributes.get("Config") or {}
        if self._containerd:
            config = self._configuration(name, attributes["Id"], wanted, size=attributes["Size"])
            if config is not None:
                shown, identity = wanted, f"sha256:{hashlib.sha256(config).hexdigest()}"
                described = json.loads(config)
                layers, settings = tuple(described["rootfs"]["diff_ids"]), described.get("config") or {}
        return Image(
            reference=name,
            platform=shown,
            size=attributes["Size"],
            identity=identity,
            layers=layers,
            l4t=image.l4t(name, settings),
        )

    @functools.cached_property
    def _containerd(self) -> bool:
        """Whether the engine keeps images in containerd, where the ID of an image is not the one of its configuration."""
        try:
            status = self._client.info().get("DriverStatus") or []
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"Docker on this computer does not answer: {problem}") from problem
        return any("io.containerd.snapshotter" in str(pair) for pair in status)

    def _configuration(self, name: str, image_id: str, platform: str, *, size: int) -> bytes | None:
        """Read it out of a push, or else out of the archive of the image, and keep it: the archive may be large.

        The file is named by the ID, the platform, and the digest of its content.
        """
        kept = folder() / f"{image_id.removeprefix('sha256:')}.{platform.replace('/', '-')}"
        with contextlib.suppress(OSError):
            for path in kept.parent.glob(f"{kept.name}.*"):
                data = path.read_bytes()
                if path.name == f"{kept.name}.{hashlib.sha256(data).hexdigest()}":
                    return data
        try:
            config = self._pushed_configuration(name, image_id, platform=platform, size=size)
            config = config or image.configuration(small_members(self._saved(name)), platform)
        except tarfile.TarError as problem:
            raise DesktopError(f"what Docker saves of image {name} cannot be read: {problem}") from problem
        if config is not None:
            with contextlib.suppress(OSError):  # it is read again then
                kept.parent.mkdir(parents=True, exist_ok=True)
                part = kept.with_name(f".{os.getpid()}.{threading.get_ident()}")
                part.write_bytes(config)
                part.replace(kept.with_name(f"{kept.name}.{hashlib.sha256(config).hexdigest()}"))
        return config

    def environment(self, wanted: Image) -> dict[str, str]:
        """The variables that an image sets. Raises as `find`."""
        attributes = self._inspected(wanted.reference) or {}
        pairs = (attributes.get("Config") or {}).get("Env") or ()
        return dict(pair.split("=", 1) for pair in pairs if "=" in pair)

    def names_in(self, wanted: Image, folder: str) -> frozenset[str]:
        """The names of the files in a folder of an image; none if there is no such folder. Nothing of the image runs.

        Raises:
            DesktopError: Docker does not answer, or refuses.

        """
        platform = wanted.platform if self._containerd else None
        try:
            container = self._client.api.create_container(
                wanted.reference, command=["true"], platform=platform
            )["Id"]
            try:
                chunks, _ = self._client.api.get_archive(container, folder)
                with tarfile.open(fileobj=io.BufferedReader(Chunks(chunks), CHUNK), mode="r|") as archive:
                    paths = [member.name for member in archive if not member.isdir()]
            except self._errors.NotFound:
                return frozenset()
            finally:
                self._client.api.remove_container(container, force=True)
        except (self._errors.DockerException, OSError, tarfile.TarError) as problem:
            raise DesktopError(f"looking into image {wanted.reference} failed: {problem}") from problem
        return frozenset(path.rpartition("/")[2] for path in paths)

    def export(self, wanted: Image) -> Generator[bytes]:
        """The image as ``docker save`` writes it, under its own name. Raises as `archive`."""
        yield from self._saved(wanted.reference)

    def _saved(self, reference: str) -> Generator[bytes]:
        try:
            yield from self._client.api.get_image(reference, chunk_size=CHUNK)
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"reading image {reference} from Docker failed: {problem}") from problem

    def archive(self, local: str, reference: str) -> Generator[bytes]:
        """The image ``local`` as ``docker save`` writes it, named ``reference``, in pieces of at most 1 MiB.

        The archive contains the name by which it is asked for. It is a name here too, for as long as it is read.

        Raises:
            DesktopError: the engine fails while it is read.

        """
        try:
            with self._turns, self._named(local, reference):
                yield from _gathered(self._client.api.get_image(reference, chunk_size=CHUNK))
        except (self._errors.DockerException, OSError) as problem:
            raise DesktopError(f"reading image {reference} from Docker failed: {problem}") from problem

    @contextlib.contextmanager
    def _named(self, local: str, reference: str) -> Generator[None]:
        """Give an image a second name until the last of those who asked for it has done with it."""
        with self._names_lock:
            if not self._names[reference]:
                self._client.images.get(local).tag(reference)
            self._names[reference] += 1
        try:
            yield
        finally:
            with self._names_lock:
                self._names[reference] -= 1
                if not self._names[reference]:
                    self._forget(reference)

    def _forget(self, reference: str) -> None:
        with contextlib.suppress(self._errors.DockerException, OSError):  # somebody else removed it
            self._client.images.remove(reference, noprune=True)

    @contextlib.contextmanager
    def pushed(self, wanted: Image, layers: Collection[str]) -> Generator[Mapping[str, Path]]:
        """Files by digest, out of a push: the configuration of an image and its ``layers`` (diff IDs), as Docker packs them.

        Nothing, or a part of it, if a push cannot bring them or would take longer than `export`.
        """
        with _scratch() as place:
            yield self._push(wanted, layers, place) if self._may_push(wanted, layers) else {}

    def _may_push(self, wanted: Image, layers: Collection[str]) -> bool:
        """Whether pushing ``layers`` is faster than `export`. A containerd store does not pack them for it."""
        if self._client.api.base_url != _LOCAL:
            return False
        if self._containerd or not layers:
            return True
        try:
            history: list[dict[str, int]] = self._client.api.history(wanted.reference)  # type: ignore[no-untyped-call]
        except (self._errors.DockerException, OSError):
            return False
        # Newest first. Which entries of size 0 are layers, only the configuration knows: so this is at least their size.
        sizes = [entry["Size"] for entry in history if entry["Size"]]
        above = len(wanted.layers) - min(wanted.layers.index(layer) for layer in layers)
        return 4 * sum(sizes[:above]) < wanted.size

    def _push(self, wanted: Image, layers: Collection[str], folder: Path) -> dict[str, Path]:
        # The second time it is known by which digest Docker knows a layer that it thought to be there.
        lacks, arrived = {wanted.identity}, dict[str, Path]()
        for _ in range(2):
            registry = self._push_once(
                wanted.reference,
                lacks,
                folder=folder,
                size=wanted.size,
                # A classic store sends the configuration when the layers are through.
                uploads=len(layers) + 1 if self._containerd else max(1, len(layers)),
            )
            arrived |= registry.files
            found = dict(map(push.blobs_of, registry.manifests))
            known = dict(zip(wanted.layers, found.get(wanted.identity, ()), strict=False))
            missing = {known[layer] for layer in layers if layer in known} - arrived.keys()
            if not missing:
                break
            lacks |= missing
        return arrived

    def _push_once(
        self, reference: str, lacks: Collection[str], *, folder: Path, size: int, uploads: int
    ) -> push.Registry:
        """Push an image of ``size`` bytes, unless Docker begins more ``uploads`` at once, or takes longer than `export` would."""
        registry = push.Registry(lacks=lacks, folder=folder, most=size + SMALL, refuses=not self._containerd)
        with contextlib.suppress(self._errors.DockerException, OSError), contextlib.ExitStack() as stack:
            stack.enter_context(registry)
            one = self._begin_push(reference, registry, stack)
            one.wait(while_=lambda: registry.at_once <= uploads, seconds=2 + size / _SAVES)
        return registry

    def _pushed_configuration(self, name: str, image_id: str, *, platform: str, size: int) -> bytes | None:
        """The configuration of an image in a containerd store, for a platform: the manifests name it, and a second push brings it."""
        if self._client.api.base_url != _LOCAL:
            return None
        with _scratch() as folder:
            manifests = self._push_once(name, (), folder=folder, size=size, uploads=0).manifests
            if image_id not in {f"sha256:{hashlib.sha256(data).hexdigest()}" for data in manifests}:
                return None
            configs = {push.blobs_of(data)[0] for data in manifests} - {""}
            files = self._push_once(name, configs, folder=folder, size=SMALL, uploads=len(configs)).files
            small = {f"blobs/sha256/{path.name}": path.read_bytes() for path in files.values()}
            listing = json.dumps([{"Config": path} for path in small]).encode()
            return image.configuration({**small, "manifest.json": listing}, platform)

    def prime(self, wanted: Image) -> None:
        """Let Docker push an image into nothing until the store is closed: what it has pushed once, it can leave out later.

        One image at a time is enough. A containerd store knows what it has anyway.
        """
        if self._primed or self._client.api.base_url != _LOCAL or self._containerd:
            return
        self._primed = True
        with contextlib.suppress(self._errors.DockerException, OSError):
            used = contextlib.ExitStack()
            self._primer.callback(used.close)
            registry = used.enter_context(push.Registry(lacks=(), folder=None, most=0))
            pushing = self._begin_push(wanted.reference, registry, used)

            def finish() -> None:
                pushing.over.wait()
                used.close()  # the port is free for the next push

            finishing = threading.Thread(target=finish, daemon=True)
            finishing.start()
            self._primer.callback(finishing.join, _FINISHING)
            self._primer.callback(pushing.stop)

    def _begin_push(self, local: str, registry: push.Registry, stack: contextlib.ExitStack) -> push.Push:
        """Begin to push an image under a name that it has until the stack is closed."""
        tag = push.own_tag()
        stack.enter_context(self._named(local, f"{registry.repository}:{tag}"))

        def upload(repository: str, tag: str) -> Iterable[Mapping[str, Any]]:
            events: Iterable[Mapping[str, Any]] = self._client.api.push(
                repository, tag=tag, stream=True, decode=True, auth_config={}
            )
            return events

        return push.Push(upload, registry=registry, tag=tag)


def folder() -> Path:
    """Where configurations are kept; the variable ``XDG_CACHE_HOME`` changes it. It may be removed at any time."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet" / "configurations"


def docker_login(host: str) -> tuple[str, str] | None:
    """The user and the password of `docker login` for a registry, from Docker's settings or its credential store.

    Raises:
        DesktopError: the credential store fails.

    """
    import docker  # noqa: PLC0415  see above

    try:
        found = docker.auth.load_config().resolve_authconfig(host) or {}  # type: ignore[attr-defined]
    except docker.errors.DockerException as problem:
        raise DesktopError(f"Docker's credential store fails for {host}: {problem}") from problem
    said = {key.lower(): value for key, value in found.items()}  # a store writes its keys in capitals
    user, password = said.get("username"), said.get("password")
    return (user, password) if user and password else None


@contextlib.contextmanager
def _scratch() -> Generator[Path]:
    """A folder for what is pushed. It is not in the system's temporary folder, which may be in memory."""
    above = folder().parent
    above.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".push-", dir=above) as name:
        yield Path(name)


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
