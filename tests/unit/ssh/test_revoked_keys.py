from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.errors import UntrustedHostKey
from fleet.ssh.revoked_keys import refuse
from tests.support.sshd import make_key, public_key

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def listed(path: Path, *keys: Path) -> None:
    """A list of public keys, as a person writes one."""
    lines = [key.with_name(key.name + ".pub").read_text() for key in keys]
    path.write_text("# lost in the field\n\nnot a key\n" + "".join(lines))


def krl(path: Path, *keys: Path) -> None:
    """A key revocation list, as ssh-keygen makes one."""
    public = [f"{key}.pub" for key in keys]
    subprocess.run(("ssh-keygen", "-q", "-k", "-f", path, *public), check=True, capture_output=True)


@pytest.fixture
def keys(tmp_path: Path) -> list[Path]:
    return [make_key(tmp_path / name) for name in ("one", "other")]


@pytest.mark.parametrize("write", [listed, krl])
def test_the_keys_of_a_file_are_revoked(tmp_path: Path, keys: list[Path], write: Callable[..., None]) -> None:
    """Both of OpenSSH's formats; a key that is not in the file may be used."""
    path, empty = tmp_path / "revoked", tmp_path / "empty"
    write(path, keys[0])
    empty.touch()
    key = public_key(keys[0])
    with pytest.raises(UntrustedHostKey) as refused:
        refuse(key, (empty, path), name="pi1")
    assert refused.value.what == f"the host key of pi1 is revoked by {path}: {key.fingerprint}"
    refuse(public_key(keys[1]), (empty, path), name="pi1")
    refuse(key, (), name="pi1")


@pytest.mark.parametrize("content", [None, b"SSHKRL\n\0 and then garbage"], ids=["missing", "broken"])
def test_a_file_that_cannot_be_read_lets_nobody_in(
    tmp_path: Path, keys: list[Path], content: bytes | None
) -> None:
    """As with OpenSSH: nobody knows what it would have said."""
    path = tmp_path / "revoked"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UntrustedHostKey, match=f"cannot read {path}, so every host key may be revoked"):
        refuse(public_key(keys[0]), (path,), name="pi1")
