"""Which public key belongs to a private key file, and may the file be used?

With the public key, an agent's key is matched to a file's name.
"""

from __future__ import annotations

import base64
import contextlib
import os
import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_MAGIC = b"openssh-key-v1\0"


def too_open(path: Path) -> int:
    """Return the mode of a private key file of this user that others can read, write or run; otherwise 0.

    OpenSSH does not use such a key (sshkey_perm_ok in authfile.c).
    """
    with contextlib.suppress(OSError):
        seen = path.stat()
        if path.suffix != ".pub" and seen.st_uid == os.getuid() and seen.st_mode & 0o077:
            return seen.st_mode & 0o777
    return 0


def public_half(path: Path) -> bytes:
    """Return the public key in wire format, or nothing if it cannot be read without a passphrase.

    It is read from the ``.pub`` file beside ``path`` (or from ``path`` itself, if that is one), or from the private key:
    OpenSSH's format keeps the public part readable.
    """
    beside = path if path.suffix == ".pub" else path.with_name(path.name + ".pub")
    with contextlib.suppress(OSError, ValueError, IndexError, struct.error):
        if beside.is_file():
            return base64.b64decode(beside.read_text(encoding="utf-8").split()[1])
        body = base64.b64decode("".join(path.read_text(encoding="utf-8").splitlines()[1:-1]))
        if body.startswith(_MAGIC):
            return _inside(body[len(_MAGIC) :])
    return b""


def _inside(body: bytes) -> bytes:
    """Cipher, key derivation and its options as strings; the number of keys; the first public key (PROTOCOL.key)."""
    for _ in range(3):
        body = _string(body)[1]
    return _string(body[4:])[0]


def _string(body: bytes) -> tuple[bytes, bytes]:
    (length,) = struct.unpack_from(">I", body)
    return body[4 : 4 + length], body[4 + length :]
