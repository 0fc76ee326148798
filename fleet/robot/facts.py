"""What does a robot have now?"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from fleet.platforms import PLATFORM_OF_EMULATOR, PLATFORM_OF_MACHINE
from fleet.robot.image_store import ImageStore

Sudo = Literal["root", "free", "password", "none"]
Engine = Literal["ready", "absent", "stopped", "forbidden"]


@dataclass(frozen=True, kw_only=True)
class Container:
    """One container of a release. ``status`` is Docker's own sentence (``Up 3 minutes (healthy)``)."""

    name: str
    service: str
    release: str
    stack: str
    state: str
    status: str

    @property
    def healthy(self) -> bool:
        """Running, and not said to be unhealthy or still starting."""
        return self.state == "running" and "(unhealthy)" not in self.status and "(health:" not in self.status


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What one probe saw. Sizes are in bytes, the clock in seconds since the epoch, the temperature in °C.

    ``docker`` is the engine's version where this login may ask it, ``client`` that of the ``docker`` command. ``packages``
    are the installed ones that provisioning must know of. ``interrupted``: dpkg was stopped in the middle of its work.
    ``docker_source``: apt has the package source that Docker's script writes. ``images`` maps the name of each image that
    fleet sent to its identity lines (see `IDENTITY`). ``data_root`` is where Docker keeps what it has, which on
    Jetsons is often another disk. ``store`` is the image store's driver, ``containerd`` whether it is containerd's. ``stock`` is empty unless it was asked for.
    """

    machine: str = ""
    userland: str = ""
    os: str = ""
    login: str = ""
    groups: tuple[str, ...] = ()
    sudo: Sudo = "none"
    clock: float = 0.0
    disk_size: int = 0
    disk_free: int = 0
    temperature: float | None = None
    emulates: tuple[str, ...] = ()
    starts_at_boot: bool = False
    daemon_config: str = ""
    docker_group: tuple[str, ...] | None = None
    packages: tuple[str, ...] = ()
    interrupted: bool = False
    docker_source: bool = False
    current: str = ""
    checksum: str = ""
    releases: tuple[str, ...] = ()
    history: tuple[str, ...] = ()
    engine: Engine = "absent"
    docker: str = ""
    client: str = ""
    data_root: str = "/var/lib/docker"
    store: str = ""
    containerd: bool = False
    compose: str = ""
    containers: tuple[Container, ...] = ()
    images: dict[str, str] = field(default_factory=dict)
    stock: ImageStore = field(default_factory=ImageStore)
    noise: str = ""

    @property
    def platforms(self) -> tuple[str, ...]:
        """Platforms whose containers run here: the userland's own first, then those that are emulated."""
        own = PLATFORM_OF_MACHINE.get(self.userland) or PLATFORM_OF_MACHINE.get(self.machine, "")
        if self.machine == "armv6l":  # the first Pis and the Zero: their armhf is not what ARMv7 images need
            own = ""
        emulated = (PLATFORM_OF_EMULATOR.get(name, "") for name in self.emulates)
        return tuple(dict.fromkeys(platform for platform in (own, *emulated) if platform))
