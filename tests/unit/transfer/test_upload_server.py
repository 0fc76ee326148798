from __future__ import annotations

import contextlib
import hashlib
import io
import threading
from typing import IO

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.errors import DesktopError, NotAsPlanned, TimedOut
from fleet.plan.step import Upload, UploadBatch
from fleet.rollout.apply import InteractiveFeed
from fleet.transfer import upload_server
from fleet.transfer.rate_limit import RateLimiter
from fleet.transfer.upload_server import ASKS_AT_MOST, CHUNK, UploadServer

SKELETON, LAYER = b"the skeleton", b"a layer " * 30_000
NAMES = tuple(hashlib.sha256(data).hexdigest() for data in (SKELETON, LAYER))
BATCH = UploadBatch(
    label="1 of 1 layers",
    to="pi1.local",
    pieces=(
        Upload(digest=NAMES[0], size=len(SKELETON), data=SKELETON),
        Upload(digest=NAMES[1], size=len(LAYER)),
    ),
)


class Desk:
    """A server with its batch, and everything that it reported."""

    def __init__(self, *, rate: float | None = None) -> None:
        self.notes: list[str] = []
        self.ended: list[tuple[str, int, float]] = []
        self.acquired: list[int] = []
        acquired = self.acquired

        class Noted(RateLimiter):
            def acquire(self, count: int) -> None:
                acquired.append(count)
                super().acquire(count)

        self.server = UploadServer(
            BATCH, open_blob=self._open, limiter=Noted(rate), on_end=lambda *report: self.ended.append(report)
        )
        self.server.on_note = self.notes.append

    def _open(self, digest: str) -> IO[bytes]:
        if digest != NAMES[1]:
            raise DesktopError("a packed layer is gone")
        return io.BytesIO(LAYER)

    def answers(self, *output: bytes) -> bytes:
        """All bytes that the server sends to a robot with this output, which then closes the connection."""
        for data in output:
            self.server.on_output(data)
        self.server.close()
        return b"".join(self.server)


def need(number: int, offset: int) -> bytes:
    return f"need {NAMES[number]} {offset}\n".encode()


@pytest.mark.parametrize(
    ("output", "sent"),
    [
        ((need(0, 0),), SKELETON),
        ((need(1, 0),), LAYER),
        ((need(0, 4), need(1, 100_000)), SKELETON[4:] + LAYER[100_000:]),
        ((need(0, len(SKELETON)), need(1, 0)), LAYER),
        ((need(0, 0), need(0, 0)), SKELETON + SKELETON),
        ((need(0, 0) + need(1, 5) + b"enough\n",), SKELETON + LAYER[5:]),
        ((need(0, 0)[:30], need(0, 0)[30:-1], b"\n"), SKELETON),
        ((b"enough\n", need(0, 0)), b""),
        ((need(0, 0)[:-1],), b""),
        ((), b""),
        ((b"Welcome to pi1\n", need(0, 0)), SKELETON),
        ((b"\xff\xfe\n\n", need(0, 0)), SKELETON),
        ((b"need to update\nneed more 2\n" + b"x" * 100_000, b"\n", need(0, 0)), SKELETON),
    ],
)
def test_what_is_asked_for_is_sent(output: tuple[bytes, ...], sent: bytes) -> None:
    """From the byte that the robot names, until it has enough; other lines are ignored."""
    desk = Desk()
    assert desk.answers(*output) == sent
    assert desk.server.sent == len(sent)


@pytest.mark.parametrize(
    "line",
    [
        f"need {'0' * 64} 0",
        f"need {NAMES[0]} {len(SKELETON) + 1}",
        f"need {NAMES[0]} {1 << 70}",
        f"need {NAMES[0]} {'9' * 5000}",
        f"need {NAMES[0]} ²",
        f"need {NAMES[0]} ٣",
        f"need {NAMES[0]} -1",
        f"need {NAMES[0]}",
        f"need {NAMES[0]} 1 2",
    ],
    ids=lambda line: line[60:90],
)
def test_bytes_that_were_not_offered_are_refused(line: str) -> None:
    """An unknown upload, or a place where it has no byte: the robot would wait for ever for what cannot come."""
    with pytest.raises(NotAsPlanned, match="asks for bytes that it was not offered"):
        Desk().server.on_output(f"{line}\n".encode())


def test_requests_without_end_are_refused() -> None:
    """Each is a good one, and together they are a gigabyte."""
    desk = Desk()
    for _ in range(ASKS_AT_MOST):
        desk.server.on_output(need(1, 0))
    with pytest.raises(NotAsPlanned, match="again and again"):
        desk.server.on_output(need(1, 0) * 1_000_000)


def test_a_robot_that_asks_for_nothing_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """It talks, its link is alive, and it would keep the ship for ever."""
    monkeypatch.setattr(upload_server, "ASKS_WITHIN", 0.2)
    desk = Desk()
    for _ in range(3):
        desk.server.on_output(b"hello\nwait for ann@desk\n")
    with pytest.raises(TimedOut, match="asked for nothing for 0 s"):
        list(desk.server)


def test_notes_without_end_are_not_shown() -> None:
    """The terminal is not the robot's."""
    desk = Desk()
    desk.server.on_output(b"wait for ann@desk\n" * 1000)
    assert len(desk.notes) == 20


@given(st.lists(st.binary() | st.sampled_from([need(0, 0), need(1, 0), b"enough\n", b"need "])))
def test_any_output_of_a_robot_is_no_traceback(output: list[bytes]) -> None:
    """It is answered, or refused."""
    with contextlib.suppress(NotAsPlanned):
        Desk().answers(*output)


def test_an_upload_is_requested_after_another_was_sent() -> None:
    """The server waits for the next request until it is closed."""
    desk = Desk()
    flow = iter(desk.server)
    desk.server.on_output(need(0, 0))
    assert next(flow) == SKELETON
    later = threading.Timer(0.05, desk.server.on_output, (need(1, len(LAYER) - 3),))
    later.start()
    assert next(flow) == LAYER[-3:]
    desk.server.on_output(b"enough\n")
    assert list(flow) == []
    later.join()


def test_a_closed_server_ends() -> None:
    """If the connection drops while it waits, it ends and does not keep its thread for ever."""
    desk = Desk()
    ended = threading.Thread(target=lambda: list(desk.server))
    ended.start()
    desk.server.close()
    ended.join(10)
    assert not ended.is_alive()


def test_notes_on_the_robot() -> None:
    """They name the user that the robot waits for, and say when the long load begins."""
    desk = Desk()
    desk.answers(b"wait for ann@desk\n", need(0, 0), b"enough\n")
    assert desk.notes == ["wait for ann@desk, who is shipping to this robot", "load the image into Docker"]


def test_the_report_on_the_link() -> None:
    """The address, the bytes, and the seconds between the first request and the last byte."""
    desk = Desk(rate=1_000_000)
    for data in (need(0, 0), need(1, 0), b"enough\n"):
        desk.server.on_output(data)
    sent = b"".join(desk.server)
    desk.server.close()
    ((to, count, seconds),) = desk.ended
    assert (to, count) == ("pi1.local", len(sent)) == ("pi1.local", len(SKELETON) + len(LAYER))
    assert 0.05 <= seconds < 5  # about 0.2 s, but for the burst and the last chunk


def test_every_chunk_keeps_to_the_limit() -> None:
    """The limiter is asked before the bytes leave, chunk by chunk."""
    desk = Desk()
    desk.answers(need(0, 0), need(1, 0))
    assert sum(desk.acquired) == len(SKELETON) + len(LAYER)
    assert max(desk.acquired) <= CHUNK


def test_a_blob_that_was_removed_is_an_error_of_the_desktop() -> None:
    """The cache was cleared while the transfer ran."""
    batch = UploadBatch(label="", to="", pieces=(Upload(digest="f" * 64, size=1),))

    def gone(_: str) -> IO[bytes]:
        raise DesktopError("a packed layer is gone")

    server = UploadServer(batch, open_blob=gone, limiter=RateLimiter(None), on_end=lambda *_: None)
    server.on_output(f"need {'f' * 64} 0\n".encode())
    with pytest.raises(DesktopError, match="is gone"):
        list(server)


def test_it_is_an_interactive_feed() -> None:
    """So `fleet.rollout.apply` passes the robot's output to it."""
    assert isinstance(Desk().server, InteractiveFeed)
