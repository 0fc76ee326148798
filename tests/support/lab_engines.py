"""Virtual Pis that have Docker already, each another engine or another image store: what transfers must work with."""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import dataclass
from pathlib import Path

from fleet.images.docker_cli import buildkit_client, docker, docker_or_none
from fleet.lab import lifecycle
from fleet.lab.virtual_pi import ensure_image

RECIPE = Path(__file__).parents[1] / "lab" / "engine" / "Dockerfile"
CONTAINERD = '{"features": {"containerd-snapshotter": true}}'


@dataclass(frozen=True, kw_only=True)
class Engine:
    """One kind of Pi. ``suite`` is its Debian; ``packages`` are apt's words, some from the release ``beside`` it.

    ``store`` is the driver that the engine names. ``daemon`` is its ``daemon.json``.
    """

    name: str
    version: str
    store: str = "overlay2"
    compose: str
    suite: str = "trixie"
    beside: str = ""
    packages: tuple[str, ...] = ("docker.io", "docker-cli", "docker-compose")
    daemon: str = "{}"


# Bookworm's docker-compose is the old one in Python; trixie's is a Go program that its libc is new enough for.
_BOOKWORM = Engine(
    name="e20",
    version="20.10",
    compose="2.26",
    suite="bookworm",
    beside="trixie",
    packages=("docker.io", "docker-compose/trixie"),
)
# Sid's engine on trixie: sid's own systemd does not boot on a desktop that has its control groups in the old way (v1).
_SID = ("docker.io/sid", "docker-cli/sid", "docker-compose/sid", "containerd/sid", "runc/sid")
ENGINES = (
    _BOOKWORM,
    Engine(name="e26", version="26.1", compose="2.26"),
    Engine(name="e26c", version="26.1", compose="2.26", store="overlayfs", daemon=CONTAINERD),
    Engine(name="e28", version="28.5", compose="2.40", beside="sid", packages=_SID),
    Engine(
        name="e28c",
        version="28.5",
        compose="2.40",
        beside="sid",
        packages=_SID,
        store="overlayfs",
        daemon=CONTAINERD,
    ),
)


def image(engine: Engine) -> str:
    """The Pi's image, built unless one made from the same recipe is here; its name."""
    blank = ensure_image(lifecycle.RECIPE, suite=engine.suite, say=print)
    arguments = {
        "PI": blank,
        "BESIDE": engine.beside,
        "PACKAGES": " ".join(engine.packages),
        "DAEMON": engine.daemon,
    }
    content = hashlib.sha256(repr(arguments).encode() + RECIPE.read_bytes()).hexdigest()
    tag = f"fleet-lab-engine:{engine.name}-{content[:12]}"
    if not docker_or_none("image", "inspect", "--format", "{{.Id}}", tag):
        said = (part for name, value in arguments.items() for part in ("--build-arg", f"{name}={value}"))
        command = (*buildkit_client(), "build", "--progress=plain", *said, "--tag", tag, str(RECIPE.parent))
        done = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return tag


def up(name: str, directory: Path) -> None:
    """Have one Pi of each kind, whose engines answer."""
    lifecycle.have(
        {engine.name: image(engine) for engine in ENGINES}, directory=directory, name=name, say=print
    )
    for pi in lifecycle.list_(name=name):
        # Docker starts when somebody asks for it, or with the boot; asking waits for that.
        docker("exec", pi.container, "docker", "info")
