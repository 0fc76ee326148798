from __future__ import annotations

import contextlib
import gzip
import hashlib
import http.client
import json
import socket
import threading
import time
from typing import TYPE_CHECKING, Any

import pytest

from fleet.images import push
from fleet.images.push import Push, Registry
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

LAYER = gzip.compress(b"a layer")
UNKNOWN = f"sha256:{'0' * 64}"


def digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


class Client:
    """Docker's side of a push."""

    def __init__(self, registry: Registry) -> None:
        address, _, self.name = registry.repository.partition("/")
        self._connection = http.client.HTTPConnection(address, timeout=5)
        self.close = self._connection.close

    def ask(self, method: str, path: str, body: Any = None) -> tuple[int, http.client.HTTPResponse]:  # noqa: ANN401  bytes or chunks
        self._connection.request(method, path, body=body, encode_chunked=isinstance(body, list))
        answer = self._connection.getresponse()
        answer.read()
        return answer.status, answer

    def there(self, blob: str) -> bool:
        code, answer = self.ask("HEAD", f"/v2/{self.name}/blobs/{blob}")
        assert int(answer.headers["Content-Length"]) > 0  # Docker refuses an answer without one
        return code == 200

    def upload(self, data: bytes, named: str = "") -> int:
        """As Docker does: begin, the bytes in chunks of unknown number, and the digest when it is known."""
        place = self.ask("POST", f"/v2/{self.name}/blobs/uploads/")[1].headers["Location"]
        pieces = [data[at : at + 7] for at in range(0, len(data), 7)]
        code, answer = self.ask("PATCH", place, pieces)
        assert (code, answer.headers["Range"]) == (202, f"0-{len(data) - 1}")
        wanted = (named or digest(data)).replace(":", "%3A")
        return self.ask("PUT", f"{answer.headers['Location']}?digest={wanted}")[0]


@pytest.fixture(autouse=True)
def own_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of this test's own: others, and a real `fab ship`, use the usual ones."""
    monkeypatch.setattr(push, "PORTS", tuple(free_port() for _ in push.PORTS))


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[Registry]:
    with Registry(lacks={digest(LAYER)}, folder=tmp_path, most=1000) as one:
        yield one


@pytest.fixture
def client(registry: Registry) -> Iterator[Client]:
    with contextlib.closing(Client(registry)) as one:
        yield one


def test_only_what_is_wanted_is_missing(client: Client) -> None:
    """Docker asks for each layer that it knows by its digest, and uploads those that are not there."""
    assert client.ask("GET", "/v2/")[0] == 200
    assert client.there(UNKNOWN)
    assert not client.there(digest(LAYER))


def test_an_upload_arrives_under_its_digest(registry: Registry, client: Client, tmp_path: Path) -> None:
    """And then it is there: Docker asks once more before it goes on."""
    assert client.upload(LAYER) == 201
    assert registry.arrived == {digest(LAYER): tmp_path / digest(LAYER).removeprefix("sha256:")}
    assert (tmp_path / digest(LAYER).removeprefix("sha256:")).read_bytes() == LAYER
    assert (client.there(digest(LAYER)), registry.at_once) == (True, 1)


def test_uploads_at_once_are_counted(registry: Registry, client: Client) -> None:
    """By that it shows if Docker sends what is not wanted; the configuration comes when the layers are through."""
    for _ in range(2):
        client.upload(LAYER)
    assert registry.at_once == 1
    for _ in range(2):
        client.ask("POST", f"/v2/{client.name}/blobs/uploads/")
    assert registry.at_once == 2


def test_damaged_bytes_do_not_count(registry: Registry, client: Client, tmp_path: Path) -> None:
    """Another digest than Docker named."""
    assert client.upload(LAYER, named=UNKNOWN) == 400
    assert (registry.arrived, list(tmp_path.iterdir())) == ({}, [])


def test_a_stranger_cannot_fill_the_disk(registry: Registry, client: Client) -> None:
    """Any program of this computer can reach a port on loopback."""
    with pytest.raises((http.client.HTTPException, OSError)):
        client.upload(bytes(2000))
    assert registry.arrived == {}


def test_without_a_folder_bytes_are_dropped() -> None:
    """Docker has pushed them then, and knows their digests."""
    with (
        Registry(lacks=(), folder=None, most=0) as registry,
        contextlib.closing(Client(registry)) as client,
    ):
        assert client.upload(LAYER) == 201
        assert registry.arrived == {digest(LAYER): None}


def test_tls_is_refused_at_once(registry: Registry) -> None:
    """Docker tries it first, and would wait for an answer; a containerd store gives up if nothing is said."""
    address = registry.repository.partition("/")[0].split(":")
    with socket.create_connection((address[0], int(address[1])), timeout=5) as connection:
        connection.sendall(b"\x16\x03\x01\x00\x04\x01\x00\x00\x00")
        began = time.monotonic()
        assert connection.recv(5) == b"HTTP/"  # what containerd looks for (its HTTPFallback)
        assert time.monotonic() - began < 2


@pytest.mark.parametrize(("refuses", "code"), [(True, 400), (False, 201)])
def test_the_manifest_names_the_blobs(refuses: bool, code: int) -> None:
    """It is read also where it is refused, so that Docker keeps no name of the image."""
    whole = json.dumps({"config": {"digest": "c"}, "layers": [{"digest": "a"}, {"digest": "b"}]}).encode()
    with (
        Registry(lacks=(), folder=None, most=0, refuses=refuses) as registry,
        contextlib.closing(Client(registry)) as client,
    ):
        assert client.ask("PUT", f"/v2/{client.name}/manifests/1", whole)[0] == code
        assert [push.blobs_of(one) for one in registry.manifests] == [("c", ("a", "b"))]


@pytest.mark.parametrize(
    "odd", [b"", b"[]", b'{"manifests": []}', b'{"config": 1}', b'{"config": {"digest": ""}, "layers": 3}']
)
def test_what_is_no_manifest_of_an_image_names_none(odd: bytes) -> None:
    """Such as an index."""
    assert push.blobs_of(odd)[1] == ()


def test_several_runs_have_a_registry_each_until_the_ports_are_used_up(tmp_path: Path) -> None:
    """Then there is `docker save`."""
    with contextlib.ExitStack() as stack:
        every = [stack.enter_context(Registry(lacks=(), folder=tmp_path, most=0)) for _ in push.PORTS]
        assert len({one.repository for one in every}) == len(push.PORTS)
        with pytest.raises(OSError, match="in use"), Registry(lacks=(), folder=tmp_path, most=0):
            pass


def engine(*events: Mapping[str, Any], then: threading.Event | None = None) -> Any:  # noqa: ANN401  as the SDK's
    def upload(_repository: str, _tag: str) -> Iterable[Mapping[str, Any]]:
        yield from events
        while then and not then.wait(0.01):
            yield {"status": "Pushing"}

    return upload


def test_a_push_that_got_to_the_manifest_has_brought_all(registry: Registry) -> None:
    """Whatever Docker reports: it stops earlier if the engine is elsewhere, or fails."""

    def broken(_repository: str, _tag: str) -> Iterable[Mapping[str, Any]]:
        raise OSError("no engine")

    for one in (engine({"error": "no"}), broken):
        assert not Push(one, registry=registry, tag="1").wait(while_=lambda: True, seconds=5)
    registry.manifests.append(b"{}")
    assert Push(engine({"error": "no"}), registry=registry, tag="1").wait(while_=lambda: True, seconds=5)


@pytest.mark.parametrize(("goes_on", "seconds"), [(False, 60), (True, 0)])
def test_a_push_that_is_not_worth_it_is_stopped(registry: Registry, goes_on: bool, seconds: float) -> None:
    """Docker uploads more than is wanted, or takes longer than the other way."""
    never = threading.Event()
    one = Push(engine(then=never), registry=registry, tag="1")
    assert not one.wait(while_=lambda: goes_on, seconds=seconds)
    assert one.over.wait(5)


def test_no_file_is_made_when_it_is_over(tmp_path: Path) -> None:
    """Docker may still be uploading while the folder is removed."""
    with Registry(lacks={digest(LAYER)}, folder=tmp_path, most=1000) as one:
        begun, done = one.begin(), one.begin()
        one.take(done, [LAYER])
    with pytest.raises(OSError, match="closed"):
        one.take(begun, [LAYER])
    assert not one.end(done, digest(LAYER))
    assert [path.name for path in tmp_path.iterdir()] == [done]
    assert one.files == {}
