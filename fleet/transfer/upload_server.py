"""The desktop's end of ``onboard/receive.sh``: it sends the uploads that the robot asks for."""

from __future__ import annotations

import io
import queue
import re
import time
from collections import Counter
from typing import IO, TYPE_CHECKING

from fleet.errors import NotAsPlanned, TimedOut

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from fleet.plan.step import UploadBatch
    from fleet.transfer.rate_limit import RateLimiter

    Opener = Callable[[str], IO[bytes]]
    OnNote = Callable[[str], None]
    OnEnd = Callable[[str, int, float], None]

CHUNK = 64 * 1024
"""Bytes that are sent at once; the rate limiter is asked for each chunk."""


ASKS_WITHIN = 600.0
"""Seconds in which the robot must ask for bytes: it may wait for another ship, and verify a gigabyte on a slow card."""

ASKS_AT_MOST = 3
"""Requests for one upload: for all of it or the rest, and again for all of it if it was damaged."""

_NOTES = 20
"""Notes that are passed on; the robot may print them without end."""

_LINE = 4096
"""Bytes of a line that are read; requests have a hundred."""

_NEED = re.compile(r"need ([0-9a-f]{64})(?: (.*))?")
_CURE = "run the same command again; if it comes back, see whether ~/.fleet on the robot is sound"


class UploadServer:
    """One batch of uploads to one robot: an iterable of the bytes to send, which reads the robot's requests (`on_output`).

    A robot may ask for anything, or for nothing: what it can make this computer do is limited.

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
        self._asked: Counter[str] = Counter()
        self._notes = 0
        self._rest = b""
        self._began = 0.0
        self._closed = False
        self.sent = 0
        self.seconds = 0.0
        self.on_note: OnNote = lambda _: None

    def on_output(self, data: bytes) -> None:
        """Read a part of the robot's output, which may end within a line.

        Raises:
            NotAsPlanned: the robot asks for bytes that were not offered, or for the same ones again and again.

        """
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[:_LINE]
        for line in lines:
            text = line[:_LINE].decode(errors="replace")
            if need := _NEED.fullmatch(text):
                self._request(need[1], need[2] or "")
            elif text == "enough":
                self._note("load the image into Docker")
                self._requests.put(None)
            elif text.startswith("wait for "):
                self._note(f"{text}, who is shipping to this robot")
            # Anything else is the output of a login script.

    def _request(self, digest: str, offset: str) -> None:
        upload = self._uploads.get(digest)
        start = int(offset) if re.fullmatch("[0-9]{1,15}", offset) else -1
        if upload is None or not 0 <= start <= upload.size:
            what = f"the robot asks for bytes that it was not offered ({digest[:12]} from {offset[:20] or 'nowhere'})"
            raise NotAsPlanned(what, cure=_CURE)
        self._asked[digest] += 1
        if self._asked[digest] > ASKS_AT_MOST:
            raise NotAsPlanned("the robot asks for the same bytes again and again", cure=_CURE)
        self._requests.put((digest, start))

    def _note(self, text: str) -> None:
        self._notes += 1
        if self._notes <= _NOTES:
            self.on_note(text)

    def close(self) -> None:
        """End the iteration, since no request will follow; may be called twice."""
        self._requests.put(None)
        if not self._closed:
            self._closed = True
            self._on_end(self._to, self.sent, self.seconds)

    def __iter__(self) -> Iterator[bytes]:
        while request := self._next():
            self._began = self._began or time.monotonic()
            digest, offset = request
            with self._content(digest) as content:
                content.seek(offset)
                while chunk := content.read(CHUNK):
                    self._limiter.acquire(len(chunk))
                    yield chunk
                    self.sent += len(chunk)
                    self.seconds = time.monotonic() - self._began

    def _next(self) -> tuple[str, int] | None:
        try:
            return self._requests.get(timeout=ASKS_WITHIN)
        except queue.Empty:
            what = f"the robot has asked for nothing for {ASKS_WITHIN:.0f} s, so the connection was cut"
            raise TimedOut(what, cure=_CURE) from None

    def _content(self, digest: str) -> IO[bytes]:
        data = self._uploads[digest].data
        return self._open(digest) if data is None else io.BytesIO(data)
