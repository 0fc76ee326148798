"""How are a robot's questions for pieces answered? The desktop's end of `fleet.transfer.receive.SCRIPT`."""

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
    Teller = Callable[[str], None]
    Ended = Callable[[str, int, float], None]

CHUNK = 64 * 1024
"""Bytes between two looks at the limit."""


class UploadServer:
    """One parcel on its way to one robot: an iterable of the bytes to send, and a hearer of what the robot says.

    ``open_piece`` opens a piece by its digest (hex). ``on_note`` hears what the robot does when it no longer receives,
    ``ended`` to whom how many bytes went in how many seconds.
    """

    def __init__(self, parcel: UploadBatch, *, open_piece: Opener, pace: RateLimiter, ended: Ended) -> None:
        self._to = parcel.to
        self._pieces = {piece.digest: piece for piece in parcel.pieces}
        self._open = open_piece
        self._pace = pace
        self._ended = ended
        self._asked: queue.SimpleQueue[tuple[str, int] | None] = queue.SimpleQueue()
        self._rest = b""
        self._began = 0.0
        self._closed = False
        self.sent = 0
        self.seconds = 0.0
        self.on_note: Teller = lambda _: None

    def on_output(self, data: bytes) -> None:
        """Take a piece of the robot's output."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            match line.decode(errors="replace").split(" "):
                case ["need", digest, offset] if digest in self._pieces and offset.isdecimal():
                    self._asked.put((digest, int(offset)))
                case ["enough"]:
                    self.on_note("load it into Docker")
                    self._asked.put(None)
                case ["wait", "for", *who]:
                    self.on_note(f"wait for {' '.join(who)}, who is shipping to it")
                case _:  # a login script's greeting
                    pass

    def close(self) -> None:
        """Nobody asks any more; may be called twice."""
        self._asked.put(None)
        if not self._closed:
            self._closed = True
            self._ended(self._to, self.sent, self.seconds)

    def __iter__(self) -> Iterator[bytes]:
        while asked := self._asked.get():
            self._began = self._began or time.monotonic()
            digest, offset = asked
            with self._content(digest) as content:
                content.seek(offset)
                while chunk := content.read(CHUNK):
                    self._pace.take(len(chunk))
                    yield chunk
                    self.sent += len(chunk)
                    self.seconds = time.monotonic() - self._began

    def _content(self, digest: str) -> IO[bytes]:
        data = self._pieces[digest].data
        return self._open(digest) if data is None else io.BytesIO(data)
