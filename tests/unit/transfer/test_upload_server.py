from __future__ import annotations

import hashlib
import io
import threading
from typing import IO

import pytest

from fleet.errors import DesktopError
from fleet.plan.step import Upload, UploadBatch
from fleet.rollout.apply import InteractiveFeed
from fleet.transfer.rate_limit import RateLimiter
from fleet.transfer.upload_server import CHUNK, UploadServer

FRAME, LAYER = b"the frame", b"a layer " * 30_000
NAMES = tuple(hashlib.sha256(data).hexdigest() for data in (FRAME, LAYER))
PARCEL = UploadBatch(
    label="1 of 1 layers",
    to="pi1.local",
    pieces=(Upload(digest=NAMES[0], size=len(FRAME), data=FRAME), Upload(digest=NAMES[1], size=len(LAYER))),
)


class Desk:
    """A courier with its parcel, and all that it told anybody."""

    def __init__(self, *, rate: float | None = None) -> None:
        self.told: list[str] = []
        self.ended: list[tuple[str, int, float]] = []
        self.paced: list[int] = []
        paced = self.paced

        class Noted(RateLimiter):
            def take(self, count: int) -> None:
                paced.append(count)
                super().take(count)

        self.courier = UploadServer(
            PARCEL, open_piece=self._open, pace=Noted(rate), ended=lambda *said: self.ended.append(said)
        )
        self.courier.on_note = self.told.append

    def _open(self, digest: str) -> IO[bytes]:
        if digest != NAMES[1]:
            raise DesktopError("a packed layer is gone")
        return io.BytesIO(LAYER)

    def answers(self, *said: bytes) -> bytes:
        """All that it sends to a robot that says these pieces, and then nothing any more."""
        for data in said:
            self.courier.on_output(data)
        self.courier.close()
        return b"".join(self.courier)


def need(number: int, offset: int) -> bytes:
    return f"need {NAMES[number]} {offset}\n".encode()


@pytest.mark.parametrize(
    ("said", "sent"),
    [
        ((need(0, 0),), FRAME),
        ((need(1, 0),), LAYER),
        ((need(0, 4), need(1, 100_000)), FRAME[4:] + LAYER[100_000:]),
        ((need(0, len(FRAME)), need(1, 0)), LAYER),
        ((need(0, 0), need(0, 0)), FRAME + FRAME),
        ((need(0, 0) + need(1, 5) + b"enough\n",), FRAME + LAYER[5:]),
        ((need(0, 0)[:30], need(0, 0)[30:-1], b"\n"), FRAME),
        ((b"enough\n", need(0, 0)), b""),
        ((need(0, 0)[:-1],), b""),
        ((), b""),
        ((b"Welcome to pi1\n", need(0, 0)), FRAME),
        ((b"\xff\xfe\n\n", need(0, 0)), FRAME),
        ((b"need " + b"0" * 64 + b" 0\n", need(0, 0)), FRAME),
        ((f"need {NAMES[0]} -1\nneed {NAMES[0]}\nneed {NAMES[0]} 1 2\n".encode(), need(0, 0)), FRAME),
    ],
)
def test_what_is_asked_for_is_sent(said: tuple[bytes, ...], sent: bytes) -> None:
    """From the byte on that the robot names, until it has enough; greetings and what is no piece are passed over."""
    desk = Desk()
    assert desk.answers(*said) == sent
    assert desk.courier.sent == len(sent)


def test_a_piece_is_asked_for_after_another_was_sent() -> None:
    """It waits for the next question as long as there may be one: each side speaks in turn."""
    desk = Desk()
    flow = iter(desk.courier)
    desk.courier.on_output(need(0, 0))
    assert next(flow) == FRAME
    later = threading.Timer(0.05, desk.courier.on_output, (need(1, len(LAYER) - 3),))
    later.start()
    assert next(flow) == LAYER[-3:]
    desk.courier.on_output(b"enough\n")
    assert list(flow) == []
    later.join()


def test_nobody_asks_any_more() -> None:
    """The link is lost while it waits: it ends, and does not hold its thread for ever."""
    desk = Desk()
    ended = threading.Thread(target=lambda: list(desk.courier))
    ended.start()
    desk.courier.close()
    ended.join(10)
    assert not ended.is_alive()


def test_what_it_tells_of_the_robot() -> None:
    """That it waits for somebody, by name, and that it has begun with what takes long."""
    desk = Desk()
    desk.answers(b"wait for ann@desk\n", need(0, 0), b"enough\n")
    assert desk.told == ["wait for ann@desk, who is shipping to it", "load it into Docker"]


def test_what_it_tells_of_the_link() -> None:
    """To whom how many bytes went, in the time between the first question and the last byte."""
    desk = Desk(rate=1_000_000)
    for data in (need(0, 0), need(1, 0), b"enough\n"):
        desk.courier.on_output(data)
    sent = b"".join(desk.courier)
    desk.courier.close()
    ((to, count, seconds),) = desk.ended
    assert (to, count) == ("pi1.local", len(sent)) == ("pi1.local", len(FRAME) + len(LAYER))
    assert 0.05 <= seconds < 5  # about 0.2 s, but for the burst and the last chunk


def test_every_chunk_keeps_to_the_limit() -> None:
    """It is asked before the bytes leave, a little at a time."""
    desk = Desk()
    desk.answers(need(0, 0), need(1, 0))
    assert sum(desk.paced) == len(FRAME) + len(LAYER)
    assert max(desk.paced) <= CHUNK


def test_a_piece_that_is_gone_here_is_said() -> None:
    """Somebody has cleared the cache: the reason is the desktop's."""
    parcel = UploadBatch(label="", to="", pieces=(Upload(digest="f" * 64, size=1),))

    def gone(_: str) -> IO[bytes]:
        raise DesktopError("a packed layer is gone")

    courier = UploadServer(parcel, open_piece=gone, pace=RateLimiter(None), ended=lambda *_: None)
    courier.on_output(f"need {'f' * 64} 0\n".encode())
    with pytest.raises(DesktopError, match="is gone"):
        list(courier)


def test_it_is_a_conversation() -> None:
    """By that `fleet.rollout.apply` knows that it wants to hear what the robot says."""
    assert isinstance(Desk().courier, InteractiveFeed)
