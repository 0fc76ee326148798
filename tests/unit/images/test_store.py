from __future__ import annotations

import contextlib
import gc
import gzip
import hashlib
import io
import json
import subprocess
import tarfile
import threading
import uuid
import warnings
from typing import TYPE_CHECKING, Any

import pytest

from fleet.errors import DesktopError, ImageError
from fleet.images import store as stores
from fleet.images.chunks import small_members
from fleet.images.store import CHUNK, Store
from tests.support.handmade import Handmade, layer
from tests.support.lab_project import eventually

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator
    from pathlib import Path

CONFIG: dict[str, Any] = {
    "Env": ["PATH=/bin", "GREETING=hello you"],
    "Entrypoint": ["/entry point"],
    "Cmd": ["talk", "--fast"],
    "User": "1000:1000",
    "WorkingDir": "/srv",
    "Volumes": {"/b": {}, "/a": {}},
    "StopSignal": "SIGINT",
    "Healthcheck": {"Test": ["CMD", "check", "a b"], "Interval": 5_000_000_000, "Retries": 2},
}


def archive(
    tag: str, *, architecture: str = "amd64", config: dict[str, Any] | None = None, size: int = 100
) -> bytes:
    """A one-layer image, as ``docker load`` takes it."""

    def member(into: tarfile.TarFile, name: str, data: bytes) -> None:
        entry = tarfile.TarInfo(name)
        entry.size = len(data)
        into.addfile(entry, io.BytesIO(data))

    layer, whole = io.BytesIO(), io.BytesIO()
    with tarfile.open(fileobj=layer, mode="w") as inner:
        member(inner, "data", uuid.uuid4().bytes * (size // 16 + 1))
    digest = hashlib.sha256(layer.getvalue()).hexdigest()
    described = {
        "architecture": architecture,
        "os": "linux",
        "config": config or {},
        "rootfs": {"type": "layers", "diff_ids": [f"sha256:{digest}"]},
        "history": [{"created_by": "a test"}],
    }
    with tarfile.open(fileobj=whole, mode="w") as outer:
        member(outer, "config.json", json.dumps(described).encode())
        member(outer, "layer.tar", layer.getvalue())
        manifest = [{"Config": "config.json", "RepoTags": [tag], "Layers": ["layer.tar"]}]
        member(outer, "manifest.json", json.dumps(manifest).encode())
    return whole.getvalue()


class Shelf:
    """Loads images into the engine of this computer under one throw-away name, and removes them."""

    def __init__(self) -> None:
        self.name = f"fleet-test-{uuid.uuid4().hex[:12]}"

    def load(
        self, tag: str, *, architecture: str = "amd64", config: dict[str, Any] | None = None, size: int = 100
    ) -> None:
        data = archive(f"{self.name}:{tag}", architecture=architecture, config=config, size=size)
        subprocess.run(("docker", "load", "--quiet"), input=data, check=True, capture_output=True)

    def inspect(self, tag: str, template: str = "{{.Id}}") -> str:
        argv = ("docker", "image", "inspect", "--format", template, f"{self.name}:{tag}")
        return subprocess.run(argv, check=True, capture_output=True, text=True).stdout

    def tags(self) -> list[str]:
        argv = ("docker", "image", "ls", "--format", "{{.Tag}}", self.name)
        return sorted(subprocess.run(argv, check=True, capture_output=True, text=True).stdout.split())

    def clear(self) -> None:
        if names := [f"{self.name}:{tag}" for tag in self.tags()]:
            subprocess.run(("docker", "image", "rm", "--force", *names), check=True, capture_output=True)


@pytest.fixture
def shelf(desktop: None) -> Iterator[Shelf]:  # noqa: ARG001
    one = Shelf()
    yield one
    one.clear()


@pytest.fixture
def store(desktop: None) -> Iterator[Store]:  # noqa: ARG001
    with Store() as opened:
        yield opened


def test_the_identity_is_the_digest_of_all_of_the_configuration(shelf: Shelf, store: Store) -> None:
    """A label, a port, a comment in the history: whatever differs makes another image."""
    seen = set()
    config: dict[str, Any]
    for config in (
        {},
        CONFIG,
        {"Labels": {"version": "1"}},
        {"Labels": {"version": "2"}},
        {"ExposedPorts": {"80/tcp": {}}},
    ):
        shelf.load("latest-amd64", config=config)
        found = store.find(shelf.name, "linux/amd64")
        small = small_members(store.export(found))
        assert found.identity in {f"sha256:{hashlib.sha256(data).hexdigest()}" for data in small.values()}
        seen.add(found.identity)
    assert len(seen) == 5


def test_what_is_in_an_image(shelf: Shelf, store: Store) -> None:
    """Its variables, and the names of a folder; it does not run for that, and no container is left."""
    shelf.load("latest-amd64", config=CONFIG)
    shelf.load("latest-arm64", architecture="arm64")
    found = store.find(shelf.name, "linux/amd64")
    assert store.environment(found) == {"PATH": "/bin", "GREETING": "hello you"}
    for image in (found, store.find(shelf.name, "linux/arm64")):
        assert store.names_in(image, "/data") == {"data"}
        assert store.names_in(image, "/opt/ros") == frozenset()
        left = ("docker", "ps", "--all", "--quiet", "--filter", f"ancestor={image.reference}")
        assert not subprocess.run(left, check=True, capture_output=True).stdout


@pytest.mark.parametrize("name", ["Talker", "a:1:2", "http://registry/x", "a b"])
def test_a_name_that_docker_refuses_is_refused(store: Store, name: str) -> None:
    """With Docker's reason."""
    with pytest.raises(ImageError, match=r"refuses the image name|there is no image"):
        store.find(name, "linux/amd64")


def test_the_build_for_the_platform_is_found_first(shelf: Shelf, store: Store) -> None:
    """A name without a platform may hold anything; the tag for the platform holds what was built for it."""
    shelf.load("latest", architecture="amd64")
    shelf.load("latest-arm64", architecture="arm64")
    found = store.find(shelf.name, "linux/arm64")
    assert (found.reference, found.platform) == (f"{shelf.name}:latest-arm64", "linux/arm64")
    assert found.size > 0
    assert store.find(shelf.name, "linux/amd64").reference == f"{shelf.name}:latest"


def test_a_32_bit_arm_image_is_taken_for_v7(shelf: Shelf, store: Store) -> None:
    """Docker's classic store forgets the variant of many of them."""
    shelf.load("latest-armv7", architecture="arm")
    assert store.find(shelf.name, "linux/arm/v7").platform == "linux/arm/v7"


def test_an_image_for_another_platform_is_refused(shelf: Shelf, store: Store) -> None:
    """It would be sent, loaded, and end with ``exec format error`` on the robot."""
    shelf.load("latest-arm64", architecture="amd64")
    with pytest.raises(ImageError) as caught:
        store.find(shelf.name, "linux/arm64")
    assert caught.value.what == (
        f"the image {shelf.name}:latest-arm64 was built for linux/amd64, and the robot runs linux/arm64"
    )
    assert caught.value.cure == "run `fab build`"


def test_an_image_that_is_not_here_is_refused(shelf: Shelf, store: Store) -> None:
    """Said with the name of the Compose file, not with the tag for the platform."""
    with pytest.raises(ImageError) as caught:
        store.find(f"{shelf.name}:7", "linux/arm64")
    assert caught.value.what == f"there is no image {shelf.name}:7 for linux/arm64 here"


def test_an_archive_flows_in_pieces_and_holds_the_image_under_its_new_name(
    shelf: Shelf, store: Store
) -> None:
    """What is read here is what ``docker load`` makes the same image of, and no piece is larger than 1 MiB."""
    shelf.load("latest-amd64", config=CONFIG, size=3 * CHUNK)
    found = store.find(shelf.name, "linux/amd64")
    pieces = list(store.archive(found.reference, found.shipped_as))
    assert shelf.tags() == ["latest-amd64"]  # the other name was there only while it was read
    assert len(pieces) > 3
    assert max(len(piece) for piece in pieces) <= CHUNK
    shelf.clear()
    subprocess.run(("docker", "load", "--quiet"), input=b"".join(pieces), check=True, capture_output=True)
    assert shelf.tags() == [found.shipped_as.rpartition(":")[2]]
    assert shelf.inspect(shelf.tags()[0]).strip() == found.identity


def test_an_image_that_goes_away_while_it_is_wanted_is_the_desktops_failure(
    shelf: Shelf, store: Store
) -> None:
    """Somebody pruned between the plan and its step."""
    with pytest.raises(
        DesktopError, match=f"reading image {shelf.name}:fleet-1 from Docker failed: .*No such image"
    ):
        list(store.archive(f"{shelf.name}:gone", f"{shelf.name}:fleet-1"))


def test_archives_that_are_left_half_read_do_not_keep_others_waiting(shelf: Shelf, store: Store) -> None:
    """Robots that vanish in the middle give their turn back: only so many read from the engine at once."""
    shelf.load("latest-amd64", size=3 * CHUNK)
    for _ in range(10):
        pieces = store.archive(f"{shelf.name}:latest-amd64", f"{shelf.name}:fleet-1")
        assert next(pieces)
        pieces.close()


def test_only_so_many_archives_are_read_at_once(shelf: Shelf, store: Store) -> None:
    """The engine stages each on this computer's disk first: the ninth begins when one has ended."""
    shelf.load("latest-amd64", size=3 * CHUNK)

    def begin() -> Generator[bytes]:
        pieces = store.archive(f"{shelf.name}:latest-amd64", f"{shelf.name}:fleet-1")
        next(pieces)
        return pieces

    reading = [begin() for _ in range(8)]
    ninth = threading.Thread(target=lambda: begin().close())
    ninth.start()
    ninth.join(0.5)
    assert ninth.is_alive()
    reading.pop().close()
    ninth.join(10)
    assert not ninth.is_alive()
    for pieces in reading:
        pieces.close()


@contextlib.contextmanager
def failed_connection() -> Iterator[None]:
    """The SDK forgets to close the socket of a connection that fails; nothing of ours can."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        yield
        gc.collect()


@pytest.mark.parametrize("address", ["unix:///nonexistent/docker.sock", "tcp://127.0.0.1:1", "nonsense"])
def test_no_engine_on_this_computer_is_one_sentence(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever DOCKER_HOST says, and whichever library notices."""
    monkeypatch.setenv("DOCKER_HOST", address)
    with failed_connection(), pytest.raises(DesktopError, match="Docker on this computer does not answer: "):
        Store()


@pytest.mark.usefixtures("desktop")
def test_the_engine_is_the_one_of_the_docker_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without DOCKER_HOST the current context counts, as for ``docker`` itself."""
    monkeypatch.delenv("DOCKER_HOST", raising=False)
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    subprocess.run(
        ("docker", "context", "create", "away", "--docker", "host=unix:///nonexistent/away.sock"),
        check=True,
        capture_output=True,
    )
    subprocess.run(("docker", "context", "use", "away"), check=True, capture_output=True)
    with failed_connection(), pytest.raises(DesktopError, match="does not answer"):
        Store()


def test_a_changed_layer_is_pushed_without_the_others(shelf: Shelf, store: Store) -> None:
    """Once Docker has pushed those below; nothing of it stays behind in Docker."""
    base = layer(uuid.uuid4().int, size=900_000)
    versions = [
        Handmade(layers=(base, layer(number)), reference=f"{shelf.name}:{number}") for number in (1, 2)
    ]
    for one in versions:
        subprocess.run(
            ("docker", "load", "--quiet"), input=one.saved("20.10"), check=True, capture_output=True
        )
    first, second = (store.find(one.reference, "linux/amd64") for one in versions)
    with store.pushed(first, first.layers) as files:
        assert files == {}  # all of it: the archive is faster
    store.prime(first)

    def brought() -> dict[str, bytes]:
        with store.pushed(second, second.layers[1:]) as files:
            return {digest: path.read_bytes() for digest, path in files.items()}

    found = eventually(lambda: len(found := brought()) == 2 and found)
    assert found
    assert found.pop(second.identity) == versions[1].config
    ((_, packed),) = found.items()
    assert gzip.decompress(packed) == versions[1].layers[1]
    store.__exit__()
    assert [store_names(one.identity) for one in (first, second)] == [{first.reference}, {second.reference}]


def store_names(identity: str) -> set[str]:
    """All names and digests by which Docker knows an image."""
    form = "{{range .RepoTags}}{{println .}}{{end}}{{range .RepoDigests}}{{println .}}{{end}}"
    argv = ("docker", "image", "inspect", "--format", form, identity)
    return set(subprocess.run(argv, check=True, capture_output=True, text=True).stdout.split())


def test_an_engine_elsewhere_is_not_asked_to_push(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its loopback is not ours."""
    monkeypatch.setattr(stores, "_LOCAL", "another")
    image = Handmade(layers=(layer(1), layer(2))).image
    with store.pushed(image, image.layers[1:]) as files:
        assert files == {}
    store.prime(image)
