"""Which ``docker`` client does this desktop have, and how is it run?

The lab and the builds are made with the docker command line, because it honours the user's contexts, ``DOCKER_HOST``
and credentials. Questions about local images go through the SDK, in `fleet.images.store`.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fleet.errors import DesktopError

if TYPE_CHECKING:
    from collections.abc import Iterator

# Docker's errors when it cannot be used at all, each with its cure.
_CURES = (
    ("permission denied", "let this login use Docker: sudo usermod -aG docker $USER, then log in again"),
    (
        "cannot connect to the docker daemon",
        "start it: sudo systemctl start docker",
    ),
    ("no space left on device", "free some disk: docker system df shows what Docker uses"),
)


def docker(*arguments: str, stdin: IO[bytes] | int = subprocess.DEVNULL, timeout: float = 120.0) -> str:
    """Run one docker command and return its standard output, stripped; ``timeout`` in seconds.

    Raises ``DesktopError`` if Docker is missing, cannot be used, takes too long or fails.
    """
    try:
        done = subprocess.run(
            ("docker", *arguments), stdin=stdin, capture_output=True, timeout=timeout, check=False
        )
    except FileNotFoundError:
        raise DesktopError(
            "Docker is not installed on this computer",
            cure="install Docker Engine: https://docs.docker.com/engine/install",
        ) from None
    except subprocess.TimeoutExpired:
        raise DesktopError(
            f"docker {arguments[0]} did not finish in {timeout:g} s", cure="see whether docker info answers"
        ) from None
    if done.returncode:
        raise refusal(arguments[0], done.stderr or done.stdout)
    return done.stdout.decode(errors="replace").strip()


def docker_or_none(*arguments: str) -> str | None:
    """Ask about one thing that may not exist: the answer, or None when Docker knows no such thing."""
    try:
        return docker(*arguments)
    except DesktopError as error:
        if re.search(r"no such|not found", error.what, re.IGNORECASE):
            return None
        raise


def refusal(command: str, output: bytes) -> DesktopError:
    """The error for a docker command that failed, with the cure where its output tells one."""
    said = output.decode(errors="replace").strip()
    cure = next((cure for sign, cure in _CURES if sign in said.lower()), "")
    last = " ".join(said.splitlines()[-3:])
    return DesktopError(f"docker {command} failed: {last or 'it gave no reason'}".rstrip("."), cure=cure)


def buildkit_client() -> tuple[str, ...]:
    """The argv prefix of a docker client that builds with BuildKit; append ``build`` and its arguments.

    Clients from 23 on need the buildx plugin; older ones have BuildKit inside, behind a variable. Every ``docker``
    on PATH is asked, because an old and a new one often live side by side.
    """
    for client in _clients():
        if _succeeds(client, "buildx", "version"):
            # A builder in a container of its own would not see local images, and bases are local.
            return ("env", f"BUILDX_BUILDER={_context(client)}", client)
        if (18, 9) <= _version(client) < (23, 0):
            return ("env", "DOCKER_BUILDKIT=1", client)
    raise DesktopError(
        "no docker client on this computer can build with BuildKit", cure="install the docker-buildx package"
    )


def _clients() -> Iterator[str]:
    for folder in dict.fromkeys(os.get_exec_path()):
        if found := shutil.which("docker", path=folder):
            yield str(Path(found))


def _succeeds(*argv: str) -> bool:
    try:
        return subprocess.run(argv, capture_output=True, timeout=20, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def _output(*argv: str) -> str:
    try:
        return subprocess.run(argv, capture_output=True, timeout=20, check=False, text=True).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return ""


def _version(client: str) -> tuple[int, int]:
    found = re.match(r"Docker version (\d+)\.(\d+)", _output(client, "--version"))
    return (int(found[1]), int(found[2])) if found else (0, 0)


def _context(client: str) -> str:
    return _output(client, "context", "inspect", "--format", "{{.Name}}") or "default"
