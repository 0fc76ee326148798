from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
from typing import IO, TYPE_CHECKING

import pytest

from fleet.plan.step import Pulled
from fleet.rollout.apply import InteractiveFeed, ServingFeed
from fleet.transfer import load_archive, pull_server
from fleet.transfer.pull_server import PullFeed, PullServer
from fleet.transfer.rate_limit import RateLimiter
from tests.support.handmade import Handmade, layer, packed

if TYPE_CHECKING:
    from collections.abc import Iterator

BLOB, CONTENT = packed(layer(1))
IMAGE = Handmade(layers=(layer(1),))
PULLED = Pulled(
    name=IMAGE.image.shipped_as,
    path="talker",
    manifest=load_archive.manifest_of(IMAGE.wanted, {BLOB.diff_id: BLOB}),
    config=IMAGE.config,
    blobs=(BLOB,),
)


def opened(digest: str) -> IO[bytes]:
    assert digest == BLOB.hex
    return io.BytesIO(CONTENT)


def server(rate: float | None = None) -> PullServer:
    return PullServer([PULLED], open_blob=opened, limiter=RateLimiter(rate))


def asked(one: PullServer, request: str) -> tuple[int, dict[str, str], bytes]:
    """The answer to one request, on a connection of its own."""
    here, there = socket.socketpair()
    with here, there:
        threading.Thread(target=one.serve, args=(there,), daemon=True).start()
        here.sendall(f"{request}\r\nConnection: close\r\n\r\n".encode())
        here.settimeout(10)
        text = b""
        with contextlib.suppress(TimeoutError):
            while b"\r\n\r\n" not in text:
                text += here.recv(1 << 20)
            head = text.partition(b"\r\n\r\n")[0].decode()
            first, *lines = head.split("\r\n")
            headers = dict(line.split(": ", 1) for line in lines)
            size = 0 if request.startswith("HEAD") else int(headers["Content-Length"])
            while len(text) < len(head) + 4 + size:
                text += here.recv(1 << 20)
    return int(first.split()[1]), headers, text[len(head) + 4 :]


def test_what_a_pull_asks_for_is_there() -> None:
    """Manifest, configuration and layers by their digests; HEAD without the bytes."""
    one = server()
    assert asked(one, "GET /v2/ HTTP/1.1")[0] == 200
    code, headers, body = asked(one, f"GET /v2/talker/manifests/{PULLED.digest} HTTP/1.1")
    assert (code, body, headers["Content-Type"]) == (200, PULLED.manifest, load_archive.MANIFEST)
    assert asked(one, f"GET /v2/talker/blobs/{PULLED.identity} HTTP/1.1")[2] == IMAGE.config
    assert asked(one, f"GET /v2/talker/blobs/{BLOB.digest} HTTP/1.1")[2] == CONTENT
    code, headers, body = asked(one, f"HEAD /v2/talker/blobs/{BLOB.digest} HTTP/1.1")
    assert (code, headers["Content-Length"], body) == (200, str(len(CONTENT)), b"")


def test_a_blob_goes_on_where_it_stopped() -> None:
    """Docker asks so within one pull; a strange range gets all of it."""
    path = f"GET /v2/talker/blobs/{BLOB.digest} HTTP/1.1\r\nRange: bytes="
    code, headers, body = asked(server(), f"{path}100-")
    assert (code, body) == (206, CONTENT[100:])
    assert headers["Content-Range"] == f"bytes 100-{len(CONTENT) - 1}/{len(CONTENT)}"
    for strange in (f"{10**14}-", "5-7", "-5", "x"):
        assert asked(server(), f"{path}{strange}")[::2] == (200, CONTENT)


@pytest.mark.parametrize(
    "path", [f"manifests/sha256:{'0' * 64}", "manifests/latest", "blobs/../x", "tags/list"]
)
def test_nothing_else_is_there(path: str) -> None:
    """Not by a tag either."""
    code, _, body = asked(server(), f"GET /v2/talker/{path} HTTP/1.1")
    assert (code, b"UNKNOWN" in body) == (404, True)


def test_what_the_script_reads_comes_first_and_then_signs_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    """Address, login and manifests, each on a line; it ends when the script has."""
    monkeypatch.setattr(pull_server, "BEAT", 0.01)
    feed = PullFeed([PULLED], address="reg.local:5000", login='{"auths":{}}')
    chunks: Iterator[bytes] = iter(feed)
    assert next(chunks).split(b"\n") == [b"reg.local:5000", b'{"auths":{}}', PULLED.manifest, b""]
    assert next(chunks) == next(chunks) == b"."
    feed.close()
    assert list(chunks) == []


def test_bytes_are_counted_and_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes that were served are signs of life too; `--limit` holds for them."""
    monkeypatch.setattr(pull_server, "TICK", 0.01)
    one = server(rate=len(CONTENT) * 4)
    counted: list[int] = []
    one.on_served = counted.append
    one.begin(40311)
    chunks = iter(one)
    assert next(chunks).startswith(b"127.0.0.1:40311\n\n")
    began = time.monotonic()
    for _ in range(3):
        asked(one, f"GET /v2/talker/blobs/{BLOB.digest} HTTP/1.1")
    assert time.monotonic() - began > 0.3
    assert next(chunks) == b"."
    one.close()
    assert sum(counted) == 3 * len(CONTENT)


def test_both_are_what_a_step_is_fed_with() -> None:
    """Only one of them has to be reached from the robot."""
    direct = PullFeed([], address="x")
    assert isinstance(direct, InteractiveFeed)
    assert not isinstance(direct, ServingFeed)
    assert isinstance(server(), ServingFeed)
