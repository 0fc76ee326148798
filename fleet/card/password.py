"""How is a password written so that nobody can read it? As ``crypt`` does with SHA-512, by ``openssl passwd``."""

from __future__ import annotations

import secrets
import subprocess

from fleet.errors import DesktopError


def hashed(password: str, *, salt: str = "") -> str:
    """Return the hash of a password; the same ``salt`` makes the same hash.

    Raises:
        DesktopError: there is no ``openssl``.

    """
    argv = ("openssl", "passwd", "-6", "-stdin", "-salt", salt or secrets.token_hex(8))
    try:
        done = subprocess.run(
            argv, input=password.encode() + b"\n", capture_output=True, check=True, timeout=60
        )
    except (OSError, subprocess.SubprocessError) as problem:
        raise DesktopError(
            f"openssl made no hash of the password: {problem}", cure="install openssl"
        ) from None
    return done.stdout.decode().strip()
