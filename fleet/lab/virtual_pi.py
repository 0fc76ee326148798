"""What is a virtual Pi made of? An image, and a ``docker run`` that makes it behave like a computer."""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.errors import DesktopError
from fleet.images import debian_base
from fleet.images.docker_cli import buildkit_client, docker_or_none, refusal
from fleet.images.emulation import desktop_platform

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SUITE = "trixie"
"""The Debian release that Raspberry Pi OS is based on."""

BUILD_TAKES = 1200.0  # seconds, for 150 MB of packages over a slow line
STOP_TAKES = 20  # seconds systemd gets for stopping a Pi's own containers before the power goes


@dataclass(frozen=True, kw_only=True)
class VirtualPi:
    """One Pi of a lab: its names for people, Docker and the network, and its platform.

    ``state`` is Docker's word, such as running or exited; "missing" before it is made.
    """

    name: str
    lab: str
    address: str
    platform: str
    state: str = "missing"

    @property
    def container(self) -> str:
        """The container's name on the desktop."""
        return f"{self.lab}-{self.name}"

    @property
    def volume(self) -> str:
        """The volume with the data of the Pi's own Docker."""
        return f"{self.container}-docker"


def run_command(pi: VirtualPi, *, image: str, network: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    """Return the arguments of ``docker`` that make and start a Pi.

    It boots systemd and later runs a Docker Engine, so it may mount and set up networks, in namespaces of its own;
    it is not privileged: no devices, no kernel modules, not the desktop's clock. It is meant for images you trust.
    """
    # SYS_PTRACE: `docker exec` and health checks join the namespaces of containers that run as another user.
    rights = ("SYS_ADMIN", "NET_ADMIN", "SYS_BOOT", "SYS_PTRACE")
    confinement = ("seccomp=unconfined", "apparmor=unconfined", "systempaths=unconfined", "label=disable")
    return (
        *("run", "--detach", "--tty", "--name", pi.container, "--hostname", pi.name),
        *("--network", network, "--ip", pi.address, "--network-alias", pi.name),
        *(part for right in rights for part in ("--cap-add", right)),
        *(part for setting in confinement for part in ("--security-opt", setting)),
        # Its own part of the control groups; with the desktop's whole tree, systemd would rearrange that.
        *("--cgroupns", "private", "--tmpfs", "/run:exec", "--tmpfs", "/tmp:exec,mode=1777"),  # noqa: S108 - the Pi's own
        *("--volume", f"{pi.volume}:/var/lib/docker"),
        # `sudo reboot` in the Pi ends the container like a failure does; after `docker stop` it stays off.
        *("--restart", "on-failure", "--stop-timeout", str(STOP_TAKES)),
        *("--log-driver", "json-file", "--log-opt", "max-size=1m"),
        *(part for label in labels for part in ("--label", label)),
        image,
    )


def ensure_image(recipe: Path, *, suite: str = SUITE, say: Callable[[str], None]) -> str:
    """Build the Pi's image if there is none of this recipe. Returns its name.

    ``recipe`` is the folder with its Dockerfile, ``suite`` the Debian release. Raises ``DesktopError`` with the end of the
    build's output.
    """
    tag = image_tag(recipe, suite=suite)
    if docker_or_none("image", "inspect", "--format", "{{.Id}}", tag):
        return tag
    client = buildkit_client()
    base = debian_base.ensure(suite, desktop_platform(), say=say)
    say("building the virtual Pi's image (about half a minute, once)")
    command = (*client, "build", "--progress=plain", "--build-arg", f"BASE={base}", "--tag", tag, str(recipe))
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=BUILD_TAKES, check=False
        )
    except subprocess.TimeoutExpired:
        raise DesktopError(
            f"building the virtual Pi's image did not finish in {BUILD_TAKES:g} s",
            cure=f"check that {debian_base.MIRROR} answers",
        ) from None
    if done.returncode:
        raise refusal("build", done.stderr or done.stdout)
    return tag


def image_tag(recipe: Path, *, suite: str = SUITE) -> str:
    """Return the image's name; it is derived from the recipe, so another recipe has another name."""
    if not (recipe / "Dockerfile").is_file():
        raise DesktopError(
            f"the virtual Pi's recipe is not in {recipe}",
            cure="install fleet again: the folder is a part of it",
        )
    # `provision` sends the convenience script to a Pi; it is not part of the image.
    parts = sorted(path for path in recipe.iterdir() if path.is_file() and path.name != "get-docker.sh")
    content = hashlib.sha256(suite.encode())
    for path in parts:
        content.update(b"\0" + path.name.encode() + b"\0" + path.read_bytes())
    return f"fleet-lab-pi:{content.hexdigest()[:12]}"
