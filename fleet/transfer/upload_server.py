"""The desktop's end of ``onboard/receive.sh``: it sends the uploads that the robot asks for."""

from __future__ import annotations

import io
import queue
import time
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from fleet.plan.step import UploadBatch
    from fleet.transfer.rate_limit import RateLimiter

    Opener = Callable[[str], IO[bytes]]
    OnNote = Callable[[str], None]
    OnEnd = Callable[[str, int, float], None]

CHUNK = 64 * 1024
"""Bytes that are sent at once; the rate limiter is asked for each chunk."""


class UploadServer:
    """One batch of uploads to one robot: an iterable of the bytes to send, which reads the robot's requests (`on_output`).

    ``open_blob`` opens the bytes of a digest (hex). ``on_note`` is called with a note on what the robot does when it does not
    receive. At the end ``on_end`` is called with the robot's address, the bytes sent and the seconds that they took.
    """

    def __init__(self, batch: UploadBatch, *, open_blob: Opener, limiter: RateLimiter, on_end: OnEnd) -> None:
        self._to = batch.to
        self._uploads = {upload.digest: upload for upload in batch.pieces}
        self._open = open_blob
        self._limiter = limiter
        self._on_end = on_end
        self._requests: queue.SimpleQueue[tuple[str, int] | None] = queue.SimpleQueue()
        self._rest = b""
        self._began = 0.0
        self._closed = False
        self.sent = 0
        self.seconds = 0.0
        self.on_note: OnNote = lambda _: None

    def on_output(self, data: bytes) -> None:
        """Read a part of the robot's output, which may end within a line."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            match line.decode(errors="replace").split(" "):
                case ["need", digest, offset] if digest in self._uploads and offset.isdecimal():
                    self._requests.put((digest, int(offset)))
                case ["enough"]:
                    self.on_note("load the image into Docker")
                    self._requests.put(None)
                case ["wait", "for", *who]:
                    self.on_note(f"wait for {' '.join(who)}, who is shipping to this robot")
                case _:  # the output of a login script
                    pass

    def close(self) -> None:
        """End the iteration, since no request will follow; may be called twice."""
        self._requests.put(None)
        if not self._closed:
            self._closed = True
            self._on_end(self._to, self.sent, self.seconds)

    def __iter__(self) -> Iterator[bytes]:
        while request := self._requests.get():
            self._began = self._began or time.monotonic()
            digest, offset = request
            with self._content(digest) as content:
                content.seek(offset)
                while chunk := content.read(CHUNK):
                    self._limiter.acquire(len(chunk))
                    yield chunk
                    self.sent += len(chunk)
                    self.seconds = time.monotonic() - self._began

    def _content(self, digest: str) -> IO[bytes]:
        data = self._uploads[digest].data
        return self._open(digest) if data is None else io.BytesIO(data)
