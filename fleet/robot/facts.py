"""What does a robot have now?"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from fleet.platforms import PLATFORM_OF_EMULATOR, PLATFORM_OF_MACHINE
from fleet.robot.image_store import ImageStore

Sudo = Literal["root", "free", "password", "none"]
EngineState = Literal["ready", "absent", "stopped", "forbidden"]


@dataclass(frozen=True, kw_only=True)
class Container:
    """One container of a release. ``status`` is Docker's text, such as ``Up 3 minutes (healthy)``."""

    name: str
    service: str
    release: str
    stack: str
    state: str
    status: str

    @property
    def healthy(self) -> bool:
        """Running, and neither unhealthy nor still starting. Without a health check, running is enough."""
        return self.state == "running" and "(unhealthy)" not in self.status and "(health:" not in self.status


@dataclass(frozen=True, kw_only=True)
class Host:
    """The computer itself. The clock is in seconds since the epoch, the temperature in °C, the memory in bytes.

    ``machine`` is the kernel's word, ``userland`` dpkg's: they differ where a 64-bit kernel runs a 32-bit system.
    ``emulates`` names the QEMU handlers that the kernel knows. Unknown memory is 0.
    """

    machine: str = ""
    userland: str = ""
    os: str = ""
    clock: float = 0.0
    temperature: float | None = None
    memory: int = 0
    emulates: tuple[str, ...] = ()

    @property
    def platforms(self) -> tuple[str, ...]:
        """Platforms whose containers run here: the userland's own first, then the emulated ones."""
        own = PLATFORM_OF_MACHINE.get(self.userland) or PLATFORM_OF_MACHINE.get(self.machine, "")
        if self.machine == "armv6l":  # the first Pis and the Zero: images for ARMv7 do not run on them
            own = ""
        emulated = (PLATFORM_OF_EMULATOR.get(name, "") for name in self.emulates)
        return tuple(dict.fromkeys(platform for platform in (own, *emulated) if platform))


@dataclass(frozen=True, kw_only=True)
class Login:
    """The user that fleet logs in as. ``noise`` is what its login scripts print, which would corrupt streams."""

    name: str = ""
    groups: tuple[str, ...] = ()
    sudo: Sudo = "none"
    noise: str = ""


@dataclass(frozen=True, kw_only=True)
class Disk:
    """The file system that holds Docker's images, in bytes. A size of 0 is unknown."""

    size: int = 0
    free: int = 0


@dataclass(frozen=True, kw_only=True)
class Docker:
    """Docker Engine and its clients.

    ``version`` is the engine's and is empty unless the state is ``ready``; ``client`` and ``compose`` are the versions of
    the ``docker`` command and of its Compose plugin. ``data_root`` is often on another disk on Jetsons. ``driver`` is the
    image store's, and ``containerd`` says whether containerd keeps the images. ``members`` are the users of the group
    ``docker``, None without such a group. ``daemon_config`` is the text of ``/etc/docker/daemon.json``.
    """

    state: EngineState = "absent"
    version: str = ""
    client: str = ""
    compose: str = ""
    data_root: str = "/var/lib/docker"
    driver: str = ""
    containerd: bool = False
    members: tuple[str, ...] | None = None
    daemon_config: str = ""
    starts_at_boot: bool = False


@dataclass(frozen=True, kw_only=True)
class Packages:
    """The state of apt and dpkg, as far as provisioning depends on it.

    ``installed`` names those of the packages that provisioning knows. ``interrupted``: dpkg was stopped in the middle of
    its work. ``docker_source``: apt has the package source that Docker's script writes.
    """

    installed: tuple[str, ...] = ()
    interrupted: bool = False
    docker_source: bool = False


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """What fleet has put on the robot.

    ``checksum`` is that of the current release's files. ``history`` holds its last lines, oldest first. ``images`` maps
    the name of each image that fleet sent to its identity lines (`fleet.images.identity.IDENTITY`). ``image_store`` is
    empty unless the probe asked for it.
    """

    current: str = ""
    checksum: str = ""
    releases: tuple[str, ...] = ()
    history: tuple[str, ...] = ()
    containers: tuple[Container, ...] = ()
    images: dict[str, str] = field(default_factory=dict)
    image_store: ImageStore = field(default_factory=ImageStore)


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What one probe saw."""

    host: Host = field(default_factory=Host)
    login: Login = field(default_factory=Login)
    disk: Disk = field(default_factory=Disk)
    docker: Docker = field(default_factory=Docker)
    packages: Packages = field(default_factory=Packages)
    fleet: Fleet = field(default_factory=Fleet)
