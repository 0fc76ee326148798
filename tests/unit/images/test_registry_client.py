from __future__ import annotations

import io
import json
import re
import socket
from typing import TYPE_CHECKING

import pytest

from fleet.config.registry import Registry
from fleet.errors import NotReady
from fleet.images import registry_client
from fleet.images.registry_client import Login, RegistryClient
from tests.support.handmade import packed
from tests.support.registry import TestRegistry, make_certificates, server_tls

if TYPE_CHECKING:
    from pathlib import Path

BLOB, CONTENT = packed(b"a layer")
TIM = Login("tim", "secret")


def client(port: int, *, login: Login | None = TIM) -> RegistryClient:
    return RegistryClient(Registry(address=f"127.0.0.1:{port}"), login=lambda: login)


def encrypted(port: int, **files: Path) -> RegistryClient:
    """One that speaks TLS, as with every address that is not loopback."""
    one = RegistryClient(Registry(address=f"127.0.0.1:{port}", **files), login=lambda: TIM)  # type: ignore[arg-type]
    one._plain = False  # noqa: SLF001
    return one


@pytest.mark.parametrize("auth", ["", "basic", "bearer"])
def test_what_was_pushed_is_there(auth: str) -> None:
    """Blobs and manifests, whatever login the registry wants; a token that has expired is asked for again."""
    with TestRegistry(auth=auth) as registry:
        one = client(registry.port)
        assert not one.has("robots/talker", "blobs", BLOB.digest)
        one.push_blob("robots/talker", BLOB, io.BytesIO(CONTENT))
        assert one.has("robots/talker", "blobs", BLOB.digest)
        registry.tokens.clear()
        one.push_manifest("robots/talker", "v1", b"{}", "application/json")
        assert registry.blobs == {BLOB.digest: CONTENT}
        assert registry.manifests["robots/talker", "v1"] == b"{}"
        if auth == "bearer":
            assert registry.scopes == [["repository:robots/talker:pull,push"]] * 2


def test_a_robot_gets_a_token_that_may_only_pull() -> None:
    """For these images and for some minutes; the password only where the registry knows nothing else."""
    configs = {}
    for auth in ("", "basic", "bearer"):
        with TestRegistry(auth=auth) as registry:
            said = client(registry.port).docker_config(("talker", "camera"))
            configs[auth] = re.sub(r"127.0.0.1:\d+", "HOST", said)
            if auth == "bearer":
                assert registry.scopes == [["repository:talker:pull", "repository:camera:pull"]]
    assert configs[""] == ""
    assert json.loads(configs["basic"]) == {"auths": {"HOST": {"auth": "dGltOnNlY3JldA=="}}}
    assert json.loads(configs["bearer"]) == {"auths": {"HOST": {"registrytoken": "token-1"}}}


@pytest.mark.parametrize("auth", ["basic", "bearer"])
@pytest.mark.parametrize("login", [None, Login("tim", "wrong")])
def test_a_login_that_is_refused(auth: str, login: Login | None) -> None:
    """One sentence, and where a login comes from."""
    with TestRegistry(auth=auth) as registry, pytest.raises(NotReady, match="login") as refused:
        client(registry.port, login=login).has("talker", "blobs", BLOB.digest)
    assert "`docker login`" in refused.value.cure
    assert "wrong" not in str(refused.value)


def test_a_full_registry() -> None:
    """Debian's registry hides the reason in the details of an unknown error."""
    with TestRegistry(full=True) as registry, pytest.raises(NotReady, match="is full") as full:
        client(registry.port).push_blob("talker", BLOB, io.BytesIO(CONTENT))
    assert "free some disk" in full.value.cure


def test_a_registry_that_takes_damage_for_damage() -> None:
    """An answer that is not expected is shown as it is."""
    with TestRegistry() as registry, pytest.raises(NotReady, match="answers 400"):
        client(registry.port).push_blob("talker", BLOB, io.BytesIO(b"x" * BLOB.size))


def test_a_registry_that_is_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused, silent, or of a name that does not exist."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        monkeypatch.setattr(registry_client, "TIMEOUT", 0.2)
        port = silent.getsockname()[1]
        with pytest.raises(NotReady, match="does not answer within"):
            client(port).has("talker", "blobs", BLOB.digest)
    with pytest.raises(NotReady, match="cannot be reached: Connection refused"):
        client(port).has("talker", "blobs", BLOB.digest)
    nowhere = RegistryClient(Registry(address="nosuch.invalid:5000"), login=lambda: None)
    with pytest.raises(NotReady, match=r"does not know the host|does not answer") as unknown:
        nowhere.has("talker", "blobs", BLOB.digest)
    assert unknown.value.cure


def test_certificates(tmp_path: Path) -> None:
    """The registry's must be signed by `ca`, ours by the registry's; a plain registry is told from an encrypted one."""
    make_certificates(tmp_path, "server", "client")
    make_certificates(tmp_path / "other", "client")
    ours = {"client_cert": tmp_path / "client.crt", "client_key": tmp_path / "client.key"}
    others = {name: tmp_path / "other" / path.name for name, path in ours.items()}
    ca = {"ca": tmp_path / "ca.crt"}
    with TestRegistry(tls=server_tls(tmp_path, clients=True)) as registry:
        assert not encrypted(registry.port, **ca, **ours).has("talker", "blobs", BLOB.digest)
        for values, what in (
            (ours, "is not trusted"),
            (ca, "wants a client certificate"),
            ({**ca, **others}, "refuses the client certificate"),
            ({**ca, **ours, "client_key": tmp_path / "server.key"}, "do not fit each other"),
            ({**ca, **ours, "client_key": tmp_path / "client.crt"}, "do not fit each other"),
        ):
            with pytest.raises(NotReady, match=what) as refused:
                encrypted(registry.port, **values).has("talker", "blobs", BLOB.digest)
            assert refused.value.cure
    with TestRegistry() as plain, pytest.raises(NotReady, match="does not speak TLS"):
        encrypted(plain.port, **ca).has("talker", "blobs", BLOB.digest)
