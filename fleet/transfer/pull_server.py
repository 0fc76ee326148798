"""The desktop's end of ``onboard/pull_images.sh``: what it reads on its standard input, and a registry that it pulls from.

The registry answers what comes through a port that the robot's sshd forwards (`fleet.ssh.session.Session.forwarded`), so
the robot needs no configuration, and nobody else can reach it. It has nothing but the images of one pull.
"""

from __future__ import annotations

import io
import json
import re
import threading
from typing import IO, TYPE_CHECKING

from fleet.images.registry_http import Handler
from fleet.ssh.channel import BEAT
from fleet.transfer.load_archive import MANIFEST

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from fleet.plan.step import Pulled
    from fleet.ssh.session import Stream
    from fleet.transfer.rate_limit import RateLimiter

    Opener = Callable[[str], IO[bytes]]

CHUNK = 64 * 1024
"""Bytes that are sent at once; the rate limiter is asked for each chunk."""

TICK = 0.5
"""Seconds between two looks at the bytes that were sent."""


class PullFeed:
    """What the robot's script reads: where the registry is, a login, the manifests, and a sign of life as long as it runs.

    ``login`` is a Docker config.json, or empty.
    """

    def __init__(self, images: Sequence[Pulled], *, address: str, login: str = "") -> None:
        self.address = address
        self._login = login
        self._images = images
        self._closed = threading.Event()
        self.on_note: Callable[[str], None] = lambda _: None

    def on_output(self, data: bytes) -> None:
        """Read nothing: the script prints nothing but what a login script printed before."""

    def close(self) -> None:
        """End the iteration; may be called twice."""
        self._closed.set()

    def __iter__(self) -> Iterator[bytes]:
        lines = (
            self.address.encode(),
            self._login.encode(),
            *(image.manifest for image in self._images),
        )
        yield b"\n".join(lines) + b"\n"
        while not self._closed.wait(self._pause()):
            yield b"."

    def _pause(self) -> float:
        return BEAT


class PullServer(PullFeed):
    """The same, and a registry on the robot's loopback: `serve` answers one connection of the robot's Docker.

    ``open_blob`` opens a layer by its digest (hex). ``on_served`` is called with the number of bytes that were sent.
    """

    def __init__(self, images: Sequence[Pulled], *, open_blob: Opener, limiter: RateLimiter) -> None:
        super().__init__(images, address="")
        self._open = open_blob
        self._limiter = limiter
        self._manifests = {image.digest: image.manifest for image in images}
        self._configs = {image.identity: image.config for image in images}
        self._blobs = {blob.digest: blob for image in images for blob in image.blobs}
        self._served = self._told = 0
        self._lock = threading.Lock()
        self.on_served: Callable[[int], None] = lambda _: None

    def begin(self, port: int) -> None:
        """Be told by which port of its loopback the robot reaches `serve`."""
        self.address = f"127.0.0.1:{port}"

    def serve(self, stream: Stream) -> None:
        """Answer the requests of one connection until it ends."""
        handler = type("Handler", (_Handler,), {"server_of": self})
        handler(_Socket(stream), ("robot", 0), None)

    def manifest(self, digest: str) -> bytes | None:
        """A manifest by its digest."""
        return self._manifests.get(digest)

    def blob(self, digest: str) -> tuple[int, IO[bytes]] | None:
        """The size of a blob and its bytes, by its digest."""
        if (config := self._configs.get(digest)) is not None:
            return len(config), io.BytesIO(config)
        if (blob := self._blobs.get(digest)) is not None:
            return blob.size, self._open(blob.hex)
        return None

    def send(self, chunk: bytes, out: IO[bytes]) -> None:
        """Send a part of a blob, when the rate allows it, and count it."""
        self._limiter.acquire(len(chunk))
        with self._lock:
            self._served += len(chunk)
        out.write(chunk)

    def close(self) -> None:
        """See `PullFeed`."""
        super().close()
        self._tell()

    def _pause(self) -> float:
        """Wait for a sign of life's time, or until something was served: that is one too."""
        for _ in range(int(BEAT / TICK)):
            if self._tell() or self._closed.wait(TICK):
                break
        return 0.0

    def _tell(self) -> int:
        with self._lock:
            count = self._served - self._told
            self._told += count
        if count:
            self.on_served(count)
        return count


class _Socket:
    """What ``http.server`` uses of a socket, of a channel."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self.settimeout = stream.settimeout
        self.sendall = stream.sendall

    def makefile(self, _mode: str, _buffering: int) -> io.BufferedReader:
        return io.BufferedReader(_Raw(self._stream))


class _Raw(io.RawIOBase):
    def __init__(self, stream: Stream) -> None:
        super().__init__()
        self._stream = stream

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        data = self._stream.recv(len(buffer))
        buffer[: len(data)] = data
        return len(data)


class _Handler(Handler):
    """The part "Pulling" of opencontainers/distribution-spec, by digest only; a blob from any offset on (RFC 9110, 14.2)."""

    server_of: PullServer

    def do_HEAD(self) -> None:  # noqa: N802  http.server calls it so
        self._find(head=True)

    def do_GET(self) -> None:  # noqa: N802  http.server calls it so
        self._find(head=False)

    def _find(self, *, head: bool) -> None:
        kind, _, digest = self.path.partition("?")[0].rpartition("/")
        if self.path == "/v2/":
            self.answer(200)
        elif kind.endswith("/manifests") and (manifest := self.server_of.manifest(digest)):
            self._send(digest, len(manifest), io.BytesIO(manifest), MANIFEST, head=head)
        elif kind.endswith("/blobs") and (blob := self.server_of.blob(digest)):
            self._send(digest, *blob, "application/octet-stream", head=head)
        else:
            self._refuse("MANIFEST_UNKNOWN" if kind.endswith("/manifests") else "BLOB_UNKNOWN")

    def _send(self, digest: str, size: int, content: IO[bytes], media_type: str, *, head: bool) -> None:
        asked = re.fullmatch(r"bytes=([0-9]{1,15})-", self.headers.get("Range", ""))
        start = int(asked[1]) if asked and int(asked[1]) < size else 0
        headers = {
            "Content-Type": media_type,
            "Content-Length": str(size - start),
            "Docker-Content-Digest": digest,
        }
        if start:
            headers["Content-Range"] = f"bytes {start}-{size - 1}/{size}"
        with content:
            self.answer(206 if start else 200, headers)
            content.seek(start)
            while not head and (chunk := content.read(CHUNK)):
                self.server_of.send(chunk, self.wfile)  # type: ignore[arg-type]  # an io.BufferedIOBase

    def _refuse(self, code: str) -> None:
        body = json.dumps({"errors": [{"code": code, "message": "this computer has no such thing"}]}).encode()
        self.answer(404, {"Content-Type": "application/json", "Content-Length": str(len(body))})
        if self.command != "HEAD":
            self.wfile.write(body)
