"""Which host keys does OpenSSH's configuration revoke? The files of ``RevokedHostKeys`` (ssh_config(5)).

A file is a list of public keys, or a key revocation list (KRL), which ``ssh-keygen`` reads. As with OpenSSH's client, a
file that cannot be read lets nobody in.
"""

from __future__ import annotations

import base64
import contextlib
import subprocess
import tempfile
from typing import TYPE_CHECKING

from fleet.errors import UntrustedHostKey

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from fleet.ssh.known_hosts import HostKey

_KRL = b"SSHKRL\n\0"


def refuse(key: HostKey, files: Iterable[Path], *, name: str) -> None:
    """Refuse the host key of ``name`` if one of the files revokes it.

    Raises:
        UntrustedHostKey: it is revoked, or a file cannot be read.

    """
    for path in files:
        try:
            revoked = _revokes(path, key)
        except OSError as problem:
            raise UntrustedHostKey(
                f"cannot read {path}, so every host key may be revoked: {problem.strerror or problem}",
                cure="make it readable, or remove RevokedHostKeys from the configuration of OpenSSH",
            ) from problem
        if revoked:
            raise UntrustedHostKey(
                f"the host key of {name} is revoked by {path}: {key.fingerprint}",
                cure="remove the old host key on it, and make a new one with `ssh-keygen -A`",
            )


def _revokes(path: Path, key: HostKey) -> bool:
    content = path.read_bytes()
    if content.startswith(_KRL):
        return _krl_revokes(path, key)
    return any(_blob(line) == key.blob for line in content.splitlines())


def _blob(line: bytes) -> bytes:
    """The key of a line ``ssh-ed25519 AAAA... comment``; nothing for a comment, or for a line that is not valid."""
    with contextlib.suppress(ValueError, IndexError):
        return base64.b64decode(line.split()[1], validate=True)
    return b""


def _krl_revokes(path: Path, key: HostKey) -> bool:
    """Ask ``ssh-keygen``, whose exit code is 1 for a revoked key. Raises OSError for a file that it cannot read."""
    with tempfile.NamedTemporaryFile(suffix=".pub") as public:
        public.write(f"{key.kind} {base64.b64encode(key.blob).decode()}\n".encode())
        public.flush()
        done = subprocess.run(
            ("ssh-keygen", "-Q", "-f", str(path), public.name),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode not in (0, 1):
        raise OSError(done.stderr.strip() or "ssh-keygen cannot read it")
    return done.returncode == 1
