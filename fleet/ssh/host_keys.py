"""How does a computer get SSH keys that are made on the desktop? ``ssh-keygen`` makes them, in a folder that goes away."""

from __future__ import annotations

import base64
import struct
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.errors import DesktopError, UsageError
from fleet.ssh import key_files
from fleet.ssh.known_hosts import HostKey

if TYPE_CHECKING:
    from collections.abc import Iterable


def make(comment: str) -> tuple[str, str]:
    """Return a new ed25519 key: the private key, and the line of the public one. The desktop keeps neither.

    Raises:
        DesktopError: there is no ``ssh-keygen``.

    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "key"
        argv = ("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", str(path))
        try:
            subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, check=True, timeout=60)
        except (OSError, subprocess.SubprocessError) as problem:
            raise DesktopError(
                f"ssh-keygen made no host key: {problem}", cure="install openssh-client"
            ) from None
        return path.read_text(), path.with_suffix(".pub").read_text().strip()


def parse(line: str) -> HostKey:
    """Return the key of a line ``TYPE BASE64 COMMENT``."""
    kind, blob = line.split()[:2]
    return HostKey(kind=kind, blob=base64.b64decode(blob))


def authorized(files: Iterable[Path], *, comment: str) -> tuple[str, ...]:
    """Return lines of ``authorized_keys`` for private keys on the desktop, each once.

    Raises:
        UsageError: there is none whose public half can be read.

    """
    blobs = dict.fromkeys(filter(None, map(key_files.public_half, files)))
    if not blobs:
        raise UsageError(
            "there is no SSH key to log in with",
            cure="`ssh-keygen -t ed25519` makes one; a key elsewhere is named as `identity_file` in the inventory, by its .pub file if only an agent has it",
        )
    return tuple(f"{_kind(blob)} {base64.b64encode(blob).decode()} {comment}" for blob in blobs)


def _kind(blob: bytes) -> str:
    """The type of a key in wire format, which begins with it (RFC 4253, 6.6)."""
    (length,) = struct.unpack_from(">I", blob)
    return blob[4 : 4 + length].decode()
