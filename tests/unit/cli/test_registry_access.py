from __future__ import annotations

import base64
import json
from typing import TYPE_CHECKING

import pytest

from fleet.cli.registry_access import address, certificates, login_of
from fleet.config.registry import Registry
from fleet.errors import DesktopError, Refused, UsageError
from fleet.images.registry_client import Login

if TYPE_CHECKING:
    from pathlib import Path


def test_the_token_is_in_a_variable_of_the_shell(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its name is in the inventory, its value nowhere; one that is not set is told with the line that sets it."""
    registry = Registry(address="reg.local:5000", user="robot", token="REG_TOKEN")  # noqa: S106
    monkeypatch.setenv("REG_TOKEN", "secret")
    assert login_of(registry) == Login("robot", "secret")
    monkeypatch.delenv("REG_TOKEN")
    with pytest.raises(Refused, match="REG_TOKEN, which is not set") as refused:
        login_of(registry)
    assert refused.value.cure == "read -rs REG_TOKEN && export REG_TOKEN"


def test_else_it_is_that_of_docker_login(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From Docker's settings, or the program that keeps its secrets; both are asked for this registry only."""
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    registry = Registry(address="reg.local:5000/robots")
    assert login_of(registry) is None
    auth = base64.b64encode(b"tim:secret").decode()
    (tmp_path / "config.json").write_text(json.dumps({"auths": {"reg.local:5000": {"auth": auth}}}))
    assert login_of(registry) == Login("tim", "secret")
    assert login_of(Registry(address="other.local:5000")) is None
    program = tmp_path / "docker-credential-test"
    said = json.dumps({"ServerURL": "reg.local:5000", "Username": "ann", "Secret": "hers"})
    program.write_text(f"#!/bin/sh\necho '{said}'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    (tmp_path / "config.json").write_text(json.dumps({"credHelpers": {"reg.local:5000": "test"}}))
    assert login_of(registry) == Login("ann", "hers")
    program.write_text("#!/bin/sh\necho 'the vault is locked'; exit 1\n")
    with pytest.raises(DesktopError, match=r"credential store fails for reg.local:5000"):
        login_of(registry)


def test_certificates_have_dockers_names(tmp_path: Path) -> None:
    """Those that are named; one that cannot be read is told before anything is done."""
    for name in ("ca", "crt", "key"):
        (tmp_path / name).write_text(name)
    one = Registry(
        address="r:5000", ca=tmp_path / "ca", client_cert=tmp_path / "crt", client_key=tmp_path / "key"
    )
    assert certificates(one) == {"ca.crt": b"ca", "client.cert": b"crt", "client.key": b"key"}
    assert certificates(None) == certificates(Registry(address="r:5000")) == {}
    (tmp_path / "key").unlink()
    with pytest.raises(UsageError, match="key cannot be read"):
        certificates(one)


def test_the_registry_of_a_command_line() -> None:
    """A host, and a path if there is one: no URL."""
    assert address("registry.local:5000/robots") == "registry.local:5000/robots"
    for wrong in ("robots", "https://registry.local"):
        with pytest.raises(UsageError, match=f"--to must be a host.*not {wrong}"):
            address(wrong)
