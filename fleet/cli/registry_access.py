"""With which login and which certificates is a registry used?"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

from fleet.config import validation
from fleet.errors import Refused, UsageError
from fleet.images.registry_client import Login
from fleet.images.store import docker_login

if TYPE_CHECKING:
    from fleet.config.registry import Registry


def login_of(registry: Registry) -> Login | None:
    """The login for a registry: a token of the shell, or the one of `docker login`; None if there is none.

    Raises:
        Refused: the inventory names a variable that is not set.
        DesktopError: the credential store of Docker fails.

    """
    if registry.token:
        password = os.environ.get(registry.token)
        if not password:
            raise Refused(
                f"the login of the registry {registry.host} is in {registry.token}, which is not set",
                cure=f"read -rs {registry.token} && export {registry.token}",
            )
        return Login(registry.user or "token", password)
    found = docker_login(registry.host)
    return Login(*found) if found else None


def address(to: str) -> str:
    """The registry of ``--to``, as it was given. Raises `UsageError` if it cannot be one."""
    if not re.search(validation.REGISTRY, to):
        raise UsageError(f"--to {validation.not_like(validation.REGISTRY, to)}, not {to}")
    return to


def certificates(registry: Registry | None) -> dict[str, bytes]:
    """The files by which Docker knows a registry, by the names that Docker gives them; none without a registry.

    Raises:
        UsageError: one cannot be read.

    """
    if registry is None:
        return {}
    named = {"ca.crt": registry.ca, "client.cert": registry.client_cert, "client.key": registry.client_key}
    try:
        return {name: path.read_bytes() for name, path in named.items() if path}
    except OSError as problem:
        what = f"{problem.filename} cannot be read: {problem.strerror}"
        raise UsageError(what, cure="correct `registry:` in the inventory") from problem
