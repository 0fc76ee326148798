"""What are a step and a plan, and how do they read as text?

Values only: a plan can be compared, printed (``--dry``) or applied (`fleet.rollout`). Nothing here touches the world.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fleet.errors import Unreachable

if TYPE_CHECKING:
    from fleet.errors import FleetError

LONG_SCRIPT = 15
"""Lines of a script that are shown; of a longer one the first, which is a comment."""

Status = Literal["done", "unchanged", "failed", "unreachable", "skipped"]


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
class Piece:
    """Bytes that a robot may ask for, from any offset on: ``digest`` is their SHA-256 in hex, ``size`` their number.

    ``there`` bytes had arrived when the robot was looked at. ``data`` are the bytes where they are few; others lie on this
    computer under their digest.
    """

    digest: str
    size: int
    there: int = 0
    data: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class Parcel:
    """Pieces that a robot asks for one after the other; ``label`` is what a person calls them, ``to`` its address."""

    label: str
    to: str
    pieces: tuple[Piece, ...]

    @property
    def size(self) -> int:
        """Bytes that will be sent: what has arrived in earlier attempts is not sent again."""
        return sum(piece.size - piece.there for piece in self.pieces)


Feed = Bytes | ImageArchive | Parcel


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
    it: bytes, time, disk; ``way`` how images are sent, where any are.
    """

    robot: str
    summary: str
    steps: tuple[Step, ...] = ()
    explain: tuple[Step, ...] = ()
    recover: tuple[Step, ...] = ()
    afterwards: tuple[Step, ...] = ()
    record: Record | None = None
    forecast: str = ""
    way: str = ""

    @property
    def size(self) -> int:
        """Bytes that will be sent to the robot."""
        return sum(step.feed.size for step in self.steps if step.feed)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one robot. ``step``, ``reason`` and ``cure`` are empty unless it failed.

    ``way`` is how images were sent, and why so where another way had failed. ``unusable``: what was sent arrived, and the robot's
    Docker cannot use it; another way of sending may help.
    """

    robot: str
    status: Status
    summary: str = ""
    step: str = ""
    reason: str = ""
    cure: str = ""
    seconds: float = 0.0
    sent: int = 0
    way: str = ""
    unusable: bool = False

    @property
    def good(self) -> bool:
        """Whether the robot is as the person asked."""
        return self.status in ("done", "unchanged")


def failure(robot: str, problem: FleetError) -> Outcome:
    """The outcome of a robot whose work ended in an error."""
    status: Status = "unreachable" if isinstance(problem, Unreachable) else "failed"
    return Outcome(robot=robot, status=status, reason=problem.what, cure=problem.cure)


def told(outcome: Outcome) -> str:
    """What became of a robot, in the line that its name begins."""
    if outcome.good:
        took = f", {human_seconds(outcome.seconds)}" if outcome.status == "done" else ""
        sent = f", sent {human_bytes(outcome.sent)}" if outcome.sent else ""
        sent += f" ({outcome.way})" if outcome.way else ""
        return f"{outcome.summary}{sent}{took}"
    first = outcome.reason.splitlines()[0] if outcome.reason else ""
    return f"{outcome.step}: {first}" if outcome.step else first


def details(outcome: Outcome) -> list[str]:
    """What is told below the robot's line: the rest of the reason (log lines), then the cure."""
    if outcome.good:
        return []
    lines = [f"  | {line}" for line in outcome.reason.splitlines()[1:]]
    return [*lines, f"  cure: {outcome.cure}"] if outcome.cure else lines


def exit_code(outcomes: tuple[Outcome, ...]) -> int:
    """0 when every robot is as asked, else 1."""
    return 0 if all(outcome.good for outcome in outcomes) else 1


def human_bytes(count: float) -> str:
    """A number of bytes as people say it, in decimal units: ``242 MB``."""
    if count < 1000:
        return f"{count:.0f} B"
    for unit in ("kB", "MB"):
        count /= 1000
        if count < 999.5:  # else it would be rounded to 1000 of this unit
            return f"{count:.1f} {unit}" if count < 9.95 else f"{count:.0f} {unit}"
    return f"{count / 1000:.1f} GB"


def human_seconds(seconds: float) -> str:
    """A span as people say it: ``8 s``, ``3 min``, ``5 h``, ``2 d``."""
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


def lines(plan: Plan) -> list[str]:
    """The plan as the text that ``--dry`` prints: a heading, then each command as one could type it on the robot."""
    sends = f", sends {human_bytes(plan.size)}" if plan.size else ""
    text = [
        f"{plan.robot}: {plan.summary}{sends}" if plan.steps else f"{plan.robot}: unchanged, {plan.summary}"
    ]
    for number, step in enumerate(plan.steps, start=1):
        text += [f"  {number}. {step.title}", _command(step)]
    if plan.forecast and plan.steps:
        text.insert(1, f"  {plan.forecast}")
    for step in (*plan.explain, *plan.recover):
        text += [f"  if a step fails: {step.title}", _command(step)]
    for step in plan.afterwards:
        text += [f"  when all is well: {step.title}", _command(step)]
    if plan.record and plan.steps:
        text += ["  at the end: one line into ~/.fleet/history"]
    return text


def _command(step: Step) -> str:
    fed = f"   # reads {step.feed.label}, {human_bytes(step.feed.size)}" if step.feed else ""
    return f"     $ {shlex.join(map(_shown, step.argv))}{fed}"


def _shown(argument: str) -> str:
    """A script that is a page long by its first line, which says what it does."""
    first, _, rest = argument.partition("\n")
    count = rest.count("\n") + 1
    return f"{first} [{count} more lines: --dry --json]" if count > LONG_SCRIPT else argument
