"""What are a step and a plan, and how do they read as text?

Values only: a plan can be compared, printed (``--dry``) or applied (`fleet.rollout.pool`). Nothing here touches the world.
"""

from __future__ import annotations

from dataclasses import dataclass


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
    """A local image, fed to a command as the archive that ``docker save`` makes; never held whole.

    ``image`` is its name here, ``reference`` the one it gets on the robot. ``size`` is Docker's figure of the image in bytes: an estimate of the archive, good enough to show progress.
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

    ``there`` bytes had arrived when the robot was looked at. ``data`` are the bytes where they are few; others lie on this
    computer under their digest.
    """

    digest: str
    size: int
    there: int = 0
    data: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class UploadBatch:
    """Pieces that a robot asks for one after the other; ``label`` is what a person calls them, ``to`` its address."""

    label: str
    to: str
    pieces: tuple[Upload, ...]

    @property
    def size(self) -> int:
        """Bytes that will be sent: what has arrived in earlier attempts is not sent again."""
        return sum(piece.size - piece.there for piece in self.pieces)


Feed = Bytes | ImageArchive | UploadBatch


@dataclass(frozen=True, kw_only=True)
class Step:
    """One command on one robot.

    ``limit`` is in seconds; the command is ended on the robot when it passes. ``None`` trusts the link's own liveness,
    for commands whose time depends on bytes and bandwidth. ``expect`` is the output that proves the step, without
    surrounding white space. A step with ``fresh_login`` runs on a new connection (group membership is read at login). One
    ``until_closed`` has its standard input held open, and ends when the connection does. A ``harmless`` one touches
    nothing that runs: when it fails, there is nothing to recover yet. One that ``resumes`` goes on where it was when it
    is run again, and so is when the link was lost.
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


@dataclass(frozen=True, kw_only=True)
class Record:
    """What the robot's history will say of a plan: which verb, to which release, by whom (``tim@desktop``)."""

    verb: str
    release: str
    by: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What will be done to one robot.

    ``explain`` runs when a step fails that is not ``harmless``, or comes after one that is not; what it prints is added
    to the reason (a container's last log lines). ``recover`` runs then and brings back what ran before. ``afterwards`` runs
    when all steps have succeeded; what fails of it is no failure. A plan without steps leaves the robot as it is, and
    ``summary`` says why; otherwise ``summary`` says what the robot will have become. ``forecast`` is what is expected of
    it: bytes, time, disk. ``transfer`` is how the images are sent, if any are.
    """

    robot: str
    summary: str
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
