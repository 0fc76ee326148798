from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.ssh.key_files import public_half, too_open
from tests.support.sshd import make_key, public_key

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("kind", ["ed25519", "rsa", "ecdsa"])
@pytest.mark.parametrize("passphrase", ["", "secret"])
def test_the_public_half_is_known_with_and_without_its_file(
    tmp_path: Path, kind: str, passphrase: str
) -> None:
    """ssh-keygen made both; they agree, also where the private half is locked."""
    path = make_key(tmp_path / "key", kind=kind, passphrase=passphrase)
    expected = public_key(path).blob
    assert public_half(path) == expected
    assert public_half(tmp_path / "key.pub") == expected
    (tmp_path / "key.pub").unlink()
    assert public_half(path) == expected


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"garbage",
        b"-----BEGIN OPENSSH PRIVATE KEY-----\n!!\n-----END OPENSSH PRIVATE KEY-----\n",
        b"-----BEGIN OPENSSH PRIVATE KEY-----\nb3BlbnNzaC1rZXktdjEAAAA=\n-----END OPENSSH PRIVATE KEY-----\n",
        b"-----BEGIN RSA PRIVATE KEY-----\nAAAA\n-----END RSA PRIVATE KEY-----\n",
        b"\xff\xfe\x00",
    ],
)
def test_a_file_that_says_nothing_has_no_public_half(tmp_path: Path, content: bytes) -> None:
    """It is no error: the file is tried as it is, and that tells what is wrong."""
    path = tmp_path / "key"
    path.write_bytes(content)
    assert public_half(path) == b""
    assert public_half(tmp_path / "missing") == b""
    assert public_half(tmp_path) == b""


@pytest.mark.parametrize(
    ("name", "mode", "answer"),
    [
        ("key", 0o600, 0),
        ("key", 0o400, 0),
        ("key", 0o700, 0),
        ("key", 0o644, 0o644),
        ("key", 0o610, 0o610),
        ("key", 0o602, 0o602),
        ("key.pub", 0o644, 0),
    ],
)
def test_a_private_key_that_others_can_read_is_too_open(
    tmp_path: Path, name: str, mode: int, answer: int
) -> None:
    """OpenSSH's rule; and ssh-keygen, which has the same one, agrees."""
    make_key(tmp_path / "key")
    path = tmp_path / name
    path.chmod(mode)
    assert too_open(path) == answer
    assert too_open(tmp_path / "missing") == 0
    if name == "key":
        said = subprocess.run(("ssh-keygen", "-y", "-f", path), capture_output=True, text=True, check=False)
        assert ("too open" in said.stderr) == bool(answer)
