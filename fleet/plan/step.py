"""What are a step and a plan?

Values only: a plan can be compared, printed (`fleet.plan.describe`) or applied (`fleet.rollout.apply`).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.config.registry import Registry
    from fleet.images.layer import Blob


@dataclass(frozen=True, kw_only=True)
class Bytes:
    """Bytes that a step feeds to its command, held in memory: small things only."""

    label: str
    data: bytes

    @property
    def size(self) -> int:
        """Bytes that will be sent."""
        return len(self.data)


@dataclass(frozen=True, kw_only=True)
class ImageArchive:
    """A local image, fed to a command as the archive that ``docker save`` makes; never held in memory as a whole.

    ``image`` is its name here, ``reference`` the one it gets on the robot. ``size`` is the image's size in bytes
    as Docker reports it: an estimate of the archive's, good enough to show progress.
    """

    image: str
    reference: str
    size: int

    @property
    def label(self) -> str:
        """What a person calls these bytes."""
        return f"image {self.reference}"


@dataclass(frozen=True, kw_only=True)
class Upload:
    """Bytes that a robot may ask for, from any offset on: ``digest`` is their SHA-256 in hex, ``size`` their number.

    ``there`` of them had arrived when the robot was probed. ``data`` holds the bytes if they are few; others are in the
    layer cache of this computer under their digest.
    """

    digest: str
    size: int
    there: int = 0
    data: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class UploadBatch:
    """The uploads that a robot asks for one after the other; ``label`` is their name for people, ``to`` the robot's address."""

    label: str
    to: str
    pieces: tuple[Upload, ...]

    @property
    def size(self) -> int:
        """Bytes that will be sent: those that arrived in earlier attempts are not sent again."""
        return sum(piece.size - piece.there for piece in self.pieces)


@dataclass(frozen=True, kw_only=True)
class Pulled:
    """An image that a robot pulls: its path in the registry, its manifest and configuration, and the blobs of its layers.

    ``name`` is its name on robots.
    """

    name: str
    path: str
    manifest: bytes
    config: bytes
    blobs: tuple[Blob, ...]

    @property
    def digest(self) -> str:
        """The digest of the manifest, by which it is pulled."""
        return f"sha256:{hashlib.sha256(self.manifest).hexdigest()}"

    @property
    def identity(self) -> str:
        """The digest of the configuration."""
        return f"sha256:{hashlib.sha256(self.config).hexdigest()}"

    @property
    def tag(self) -> str:
        """Its tag in the registry: without one, a registry that is cleaned up may lose it. Each packing has its own."""
        return f"{self.name.rpartition(':')[2]}-{self.digest.removeprefix('sha256:')[:12]}"


@dataclass(frozen=True, kw_only=True)
class Pull:
    """Images that a robot pulls from a registry: from ``registry``, or without one from this computer, through SSH.

    ``label`` is their name for people. ``bytes`` are those of the layers that the robot lacks.
    """

    label: str
    images: tuple[Pulled, ...]
    bytes: int
    registry: Registry | None = None

    @property
    def size(self) -> int:
        """Bytes that will come through SSH."""
        return 0 if self.registry else self.bytes


Feed = Bytes | ImageArchive | UploadBatch | Pull


@dataclass(frozen=True, kw_only=True)
class Step:
    """One command on one robot.

    ``limit`` is in seconds: the robot ends the command after that time. Without one, only a lost link ends it; this is for
    commands whose time depends on bytes and bandwidth. ``expect`` is the output that proves the step, without surrounding
    white space. ``fresh_login``: the step runs on a new connection, because group membership is read at login.
    ``until_closed``: its standard input is held open, and it ends with the connection. ``harmless``: it touches nothing
    that runs, so if it fails there is nothing to recover yet. ``resumes``: run again, it continues where it stopped, so it
    is run again after a lost link. ``detached``: it goes on without the desktop. Of the output, lines that begin with ``note:`` are
    shown as they come, and those that begin with ``now:`` until the next one.
    """

    title: str
    argv: tuple[str, ...]
    feed: Feed | None = None
    expect: str | None = None
    cure: str = ""
    limit: float | None = 60.0
    fresh_login: bool = False
    until_closed: bool = False
    harmless: bool = False
    resumes: bool = False
    detached: bool = False


@dataclass(frozen=True, kw_only=True)
class Record:
    """The line that a plan adds to the robot's history: the verb, the release, and who ran it (``tim@desktop``)."""

    verb: str
    release: str
    by: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What will be done to one robot, or to one of its stacks.

    ``verb`` is the verb that made the plan: no cure tells a user to run it. ``explain`` runs when a step fails that is not ``harmless``, or comes after one that is not; what it prints is added to
    the reason, and is searched for the cause. ``recover`` runs then, and undoes what the plan has begun. ``afterwards`` runs when all steps have succeeded; what fails of it is no failure. A plan without steps leaves the robot
    as it is, and ``summary`` says why; otherwise ``summary`` says what the robot will have become. ``stack`` is named if
    the plan is about one of several. ``forecast`` is what is expected of it: bytes, time, disk. ``transfer`` is how the
    images are sent, if any are. ``record`` goes into the history of the robot as a whole; a stack's own is written by what
    runs on the robot.
    """

    robot: str
    summary: str
    stack: str = ""
    verb: str = ""
    steps: tuple[Step, ...] = ()
    explain: tuple[Step, ...] = ()
    recover: tuple[Step, ...] = ()
    afterwards: tuple[Step, ...] = ()
    record: Record | None = None
    forecast: str = ""
    transfer: str = ""

    @property
    def size(self) -> int:
        """Bytes that will be sent to the robot."""
        return sum(step.feed.size for step in self.steps if step.feed)
