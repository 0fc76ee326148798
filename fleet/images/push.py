"""How does one layer get out of Docker without the others? Docker pushes the image to a registry of ours, on loopback.

``docker save`` of a classic store copies the whole image before it gives out the first byte. A push asks the registry for
each layer whether it is there (HEAD), and uploads only the others. This registry says that all are there, except those
that are wanted. A classic store cannot ask for a layer that it has never pushed or pulled, and uploads it, packed by
gzip; `Push.prime` lets it do that once, in the background.

The protocol is "Pushing" of opencontainers/distribution-spec.
"""

from __future__ import annotations

import contextlib
import hashlib
import http.server
import json
import os
import threading
import time
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import parse_qs, urlsplit

from fleet.images.registry_http import Handler

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    Upload = Callable[[str, str], Iterable[Mapping[str, Any]]]

REPOSITORY = "fleet-outbox"
"""The name of images for the time of a push; the tag is the process's number."""

PORTS = tuple(range(41370, 41374))
"""Few and fixed: Docker remembers up to 50 repositories that a layer was pushed to, and ours shall not drive out others."""

_TICK = 0.01  # seconds between two looks at a push


class Registry:
    """A registry on loopback that has every blob, except those in ``lacks``.

    ``at_once`` is the highest number of uploads at the same time. Blobs that have arrived are files in ``folder`` named by their digest (hex), whose bytes
    have that digest; without a folder they are dropped. It takes at most ``most`` bytes. ``manifests`` are those that
    were pushed, in their order. With ``refuses`` they are read and then refused: for a classic store a push that ended well
    gives the image a name for ever, by the manifest's digest.
    """

    def __init__(self, *, lacks: Iterable[str], folder: Path | None, most: int, refuses: bool = True) -> None:
        self.lacks = set(lacks)
        self.refuses = refuses
        self.at_once = 0
        self._begun = 0
        self.manifests: list[bytes] = []
        self.arrived: dict[str, Path | None] = {}
        self._folder = folder
        self._most = most
        self._parts: dict[str, tuple[Path | None, Any]] = {}
        self._lock = threading.Lock()
        self._closed = False
        self._server: http.server.ThreadingHTTPServer | None = None

    def __enter__(self) -> Self:
        """Listen. Raises ``OSError`` if all `PORTS` are in use."""
        handler = type("Handler", (_Handler,), {"registry": self})
        for port in PORTS:
            try:
                self._server = _Server(("127.0.0.1", port), handler)
            except OSError:
                if port == PORTS[-1]:
                    raise
            else:
                break
        assert self._server  # noqa: S101  for the type checker
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """Make no file any more: Docker may still be uploading, and the folder is about to be removed."""
        with self._lock:
            self._closed = True
        if self._server:
            self._server.shutdown()
            self._server.server_close()

    @property
    def repository(self) -> str:
        """The full name of `REPOSITORY`, with the address."""
        assert self._server  # noqa: S101  for the type checker
        return f"127.0.0.1:{self._server.server_port}/{REPOSITORY}"

    @property
    def files(self) -> dict[str, Path]:
        """The blobs that have arrived and are kept, by their digest."""
        return {digest: path for digest, path in self.arrived.items() if path}

    def has(self, digest: str) -> bool:
        """Whether a blob need not be uploaded."""
        return digest in self.arrived or digest not in self.lacks

    def begin(self) -> str:
        """Begin an upload; return its name."""
        with self._lock:
            self._begun += 1
            name = f"upload-{self._begun}"
            self._parts[name] = (self._folder / name if self._folder else None, hashlib.sha256())
            self.at_once = max(self.at_once, len(self._parts))
        return name

    def take(self, name: str, chunks: Iterable[bytes]) -> int:
        """Take bytes of an upload; return how many. Raises ``OSError`` if the disk or the allowance is full, or it is closed."""
        path, digest = self._parts[name]
        size = 0
        with contextlib.ExitStack() as stack:
            with self._lock:
                if self._closed:
                    raise OSError("the registry is closed")
                file = stack.enter_context(path.open("ab")) if path else None
            for chunk in chunks:
                digest.update(chunk)
                size += len(chunk)
                if file:
                    with self._lock:
                        self._most -= len(chunk)
                    if self._most < 0:
                        raise OSError("more bytes than were expected")
                    file.write(chunk)
        return size

    def end(self, name: str, wanted: str) -> bool:
        """End an upload: whether its bytes have the digest that Docker named."""
        path, digest = self._parts.pop(name)
        if f"sha256:{digest.hexdigest()}" != wanted:
            if path:
                path.unlink(missing_ok=True)
            return False
        with self._lock:
            if self._closed:
                return False
            kept = path.rename(path.with_name(digest.hexdigest())) if path and path.exists() else path
            self.arrived[wanted] = kept
        return True


class _Server(http.server.ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # Docker keeps connections open

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ANN401  see socketserver
        """Say nothing: a push that is ended closes its connections."""


class _Handler(Handler):
    registry: Registry

    def do_GET(self) -> None:  # noqa: N802  http.server calls it so
        self.answer(200 if self.path == "/v2/" else 404)

    def do_HEAD(self) -> None:  # noqa: N802  http.server calls it so
        kind, _, digest = self.path.partition("?")[0].rpartition("/")
        there = kind.endswith("/blobs") and self.registry.has(digest)
        # The size is wrong for blobs that are elsewhere. Docker writes it into the manifest, which nobody uses.
        self.answer(200 if there else 404, {"Docker-Content-Digest": digest, "Content-Length": "1"})

    def do_POST(self) -> None:  # noqa: N802  http.server calls it so
        self.drain()
        self.answer(202, {"Location": f"/v2/{REPOSITORY}/blobs/uploads/{self.registry.begin()}"})

    def do_PATCH(self) -> None:  # noqa: N802  http.server calls it so
        size = self._take()
        self.answer(202, {"Location": self.path, "Range": f"0-{max(0, size - 1)}"})

    def do_PUT(self) -> None:  # noqa: N802  http.server calls it so
        if "/manifests/" in self.path:
            manifest = b"".join(self.body())
            self.registry.manifests.append(manifest)
            digest = f"sha256:{hashlib.sha256(manifest).hexdigest()}"
            self.answer(400 if self.registry.refuses else 201, {"Docker-Content-Digest": digest})
            return
        self._take()
        digest = parse_qs(urlsplit(self.path).query).get("digest", [""])[0]
        good = self.registry.end(self._upload(), digest)
        self.answer(201 if good else 400, {"Docker-Content-Digest": digest})

    def _upload(self) -> str:
        return urlsplit(self.path).path.rpartition("/")[2]

    def _take(self) -> int:
        return self.registry.take(self._upload(), self.body())


class Push:
    """A push of a local image, in the background. ``upload`` pushes a repository and a tag, as the SDK does."""

    def __init__(self, upload: Upload, *, registry: Registry, tag: str) -> None:
        self._stopped = threading.Event()
        self.over = threading.Event()
        self._registry = registry
        work = threading.Thread(target=self._run, args=(upload, registry.repository, tag), daemon=True)
        work.start()

    def _run(self, upload: Upload, repository: str, tag: str) -> None:
        try:
            for _ in upload(repository, tag):
                if self._stopped.is_set():
                    break  # which closes the connection, and so Docker ends the push
        except Exception:  # noqa: BLE001, S110  whatever it is, there is another way
            pass
        finally:
            self.over.set()

    def stop(self) -> None:
        """Let Docker end the push soon."""
        self._stopped.set()

    def wait(self, *, while_: Callable[[], bool], seconds: float) -> bool:
        """Wait until it has ended, for at most ``seconds`` and only ``while_`` that holds: whether it got as far as the manifest."""
        deadline = time.monotonic() + seconds
        while not self.over.wait(_TICK):
            if time.monotonic() > deadline or not while_():
                self.stop()
                return False
        return bool(self._registry.manifests)


def own_tag() -> str:
    """The tag of this process's pushes."""
    return f"{os.getpid()}-{threading.get_ident() % 10**6}"


def blobs_of(manifest: bytes) -> tuple[str, tuple[str, ...]]:
    """The digests of the configuration and of the layers, lowest first, that an image's manifest names; empty for an index."""
    with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError):
        described = json.loads(manifest)
        return described["config"]["digest"], tuple(layer["digest"] for layer in described["layers"])
    return "", ()
