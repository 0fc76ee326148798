"""What does a robot have now?"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from fleet.platforms import PLATFORM_OF_EMULATOR, PLATFORM_OF_MACHINE
from fleet.robot.hardware import Hardware
from fleet.robot.image_store import ImageStore

if TYPE_CHECKING:
    from fleet.robot.claims import Claim

Sudo = Literal["root", "free", "password", "none"]
HomeState = Literal["own", "foreign", "missing"]
EngineState = Literal["ready", "absent", "stopped", "forbidden"]
EngineKind = Literal["docker", "podman", "rootless", "snap", ""]


SETTLED = 60.0
"""Seconds that a container which Docker has restarted must run before it counts as settled."""


@dataclass(frozen=True, kw_only=True)
class Container:
    """One container of a release, in Docker's words.

    ``state`` is running, exited, restarting, created, paused or dead. ``health`` is empty without a health check, else
    healthy, unhealthy or starting. ``code`` is the exit code of its last run, ``restarts`` how often Docker has started
    it again, ``policy`` its restart policy. ``since`` is when it was started, or when it ended, in seconds since the epoch.
    ``robot`` is the name that the inventory gave the robot when it was shipped.
    """

    name: str
    service: str
    release: str
    stack: str
    robot: str = ""
    state: str
    health: str = ""
    code: int = 0
    restarts: int = 0
    policy: str = "no"
    since: float = 0.0

    @property
    def completed(self) -> bool:
        """It has done its work: it ended with code 0, and nothing starts it again."""
        return self.state == "exited" and self.code == 0 and self.policy in ("", "no", "on-failure")

    @property
    def healthy(self) -> bool:
        """Running and healthy as far as it can be asked, or completed."""
        return self.completed or (self.state == "running" and self.health in ("", "healthy"))

    def looping(self, now: float) -> bool:
        """Whether it ends and is started again, over and over: Docker forgives that after some seconds, a person should not."""
        return self.state == "restarting" or (self.restarts > 0 and now - self.since < SETTLED)


@dataclass(frozen=True, kw_only=True)
class Host:
    """The computer itself. The clock is in seconds since the epoch, the temperature in °C, the memory in bytes.

    ``identity`` is the same for no two computers, not even for those whose cards are copies: machine-id and boot ID.
    ``machine`` is the kernel's word, ``userland`` dpkg's: they differ where a 64-bit kernel runs a 32-bit system.
    ``emulates`` names the QEMU handlers that the kernel knows. Unknown memory is 0. ``missing`` are the commands that the
    scripts of `fleet.onboard` need and that are not there, or only as busybox's.
    """

    identity: str = ""
    machine: str = ""
    userland: str = ""
    os: str = ""
    clock: float = 0.0
    temperature: float | None = None
    memory: int = 0
    emulates: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()

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
    """The user that fleet logs in as; ``home`` is its home directory.

    ``home_state`` is ``foreign`` if the home belongs to another user and has no place for ``~/.fleet``. ``noise`` is what
    the login scripts print, which would corrupt streams.
    """

    name: str = ""
    home: str = ""
    groups: tuple[str, ...] = ()
    sudo: Sudo = "none"
    noise: str = ""
    home_state: HomeState = "own"


@dataclass(frozen=True, kw_only=True)
class Disk:
    """Two file systems, in bytes: Docker's images, and ``home`` of the login, where uploads are gathered.

    A size of 0 is unknown. ``shared``: both are one file system.
    """

    size: int = 0
    free: int = 0
    home_free: int = 0
    shared: bool = True


@dataclass(frozen=True, kw_only=True)
class Docker:
    """Docker Engine and its clients.

    ``kind`` is the engine that the ``docker`` command leads to, empty without one; fleet can use only ``docker``.
    ``version`` is the engine's and is empty unless the state is ``ready``; ``client`` and ``compose`` are the versions of
    the ``docker`` command and of its Compose plugin. ``data_root`` is often on another disk on Jetsons. ``driver`` is the
    image store's, and ``containerd`` says whether containerd keeps the images. ``members`` are the users of the group
    ``docker``, None without such a group. ``daemon_config`` is the text of ``/etc/docker/daemon.json``. ``finish_unit`` is the SHA-256
    of the enabled unit that finishes swaps at boot, "" if there is none, "no systemd" if there cannot be one. ``runtimes``
    are those that containers may ask for, ``default_runtime`` the one of others. ``cdi``: it gives containers devices by
    their CDI names, as far as the robot has any. ``boot_unit`` is the same as
    ``finish_unit``, of the unit that starts stacks which systemd owns, and of its script.
    """

    state: EngineState = "absent"
    kind: EngineKind = ""
    version: str = ""
    client: str = ""
    compose: str = ""
    data_root: str = "/var/lib/docker"
    driver: str = ""
    containerd: bool = False
    members: tuple[str, ...] | None = None
    daemon_config: str = ""
    starts_at_boot: bool = False
    finish_unit: str = ""
    runtimes: tuple[str, ...] = ()
    default_runtime: str = ""
    cdi: bool = False
    boot_unit: str = ""


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
class Dev:
    """Who has brought files into a stack's containers with `fab dev` (``tim@desktop``), and since when (ISO 8601)."""

    by: str
    since: str


@dataclass(frozen=True, kw_only=True)
class StackFacts:
    """What the robot has of one stack.

    ``checksum`` is that of the current release's files, ``services`` those that it must run. ``history`` holds its last
    lines, oldest first. ``data`` is the size in bytes of what its containers have written, None if that was not counted
    in time. ``journal`` is what a command is doing, or was doing when the power went; empty otherwise. ``boot`` is who starts
    the current release at power-on; ``stopped``: a person has stopped it, so systemd does not.
    ``dev``: its containers have files that are not of the release.
    """

    current: str = ""
    checksum: str = ""
    releases: tuple[str, ...] = ()
    services: tuple[str, ...] = ()
    history: tuple[str, ...] = ()
    containers: tuple[Container, ...] = ()
    data: int | None = 0
    journal: str = ""
    boot: Literal["docker", "systemd"] = "docker"
    stopped: bool = False
    dev: Dev | None = None

    @property
    def running(self) -> bool:
        """Whether every service of the current release does what it should, and nothing of another one is there."""
        good = [one.healthy and one.release == self.current for one in self.containers]
        return bool(good) and all(good) and {one.service for one in self.containers} >= set(self.services)


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """What fleet has put on the robot.

    ``stacks`` maps each stack's name to what there is of it. ``images`` maps the name of each image that fleet sent to
    its identity (`fleet.images.image`). ``image_store`` and ``claims``, what all containers on the
    robot hold, are empty unless the probe asked for them.
    ``legacy`` is the stack that the first version of fleet has shipped, where its releases are not taken over yet.
    """

    stacks: dict[str, StackFacts] = field(default_factory=dict)
    legacy: str = ""
    images: dict[str, str] = field(default_factory=dict)
    image_store: ImageStore = field(default_factory=ImageStore)
    claims: tuple[Claim, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What one probe saw."""

    host: Host = field(default_factory=Host)
    login: Login = field(default_factory=Login)
    disk: Disk = field(default_factory=Disk)
    docker: Docker = field(default_factory=Docker)
    packages: Packages = field(default_factory=Packages)
    hardware: Hardware = field(default_factory=Hardware)
    fleet: Fleet = field(default_factory=Fleet)
