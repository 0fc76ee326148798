from __future__ import annotations

import pytest

from fleet.card import password
from fleet.errors import DesktopError


def test_the_hash_of_a_password() -> None:
    """As crypt(3) makes it; the same salt makes the same, and another one another."""
    one = password.hashed("geheim", salt="salt")
    assert one.startswith("$6$salt$")
    assert len(one) == len("$6$salt$") + 86
    assert one == password.hashed("geheim", salt="salt")
    assert password.hashed("geheim") != password.hashed("geheim")


def test_without_openssl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(DesktopError, match="openssl"):
        password.hashed("geheim")
