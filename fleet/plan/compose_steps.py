"""Where does fleet keep things on a robot, and which commands use them?

Plain files in the login's ``~/.fleet/``, readable and usable by hand::

    releases/<id>/   compose.yaml  compose.override.yaml  .env  files/    `docker compose up -d` works in it
    current          -> releases/<id>
    receipts/        what the images there were made of, for a containerd store
    spool/           pieces of a transfer that was cut; empty otherwise
    history          one line per ship, start, stop, rollback: when, what, release, by whom, what came of it

Every command starts in the login's home directory, so paths are relative to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.plan.step import Bytes, Record, Step

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.release import Release
from fleet.robot.history import Event
from fleet.robot.paths import HOME, PART, folder

_OURS = (
    *("COMPOSE_FILE", "COMPOSE_PROJECT_NAME", "FLEET_ROBOT"),
    *("ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "ROS_NAMESPACE"),
)
"""Variables that a robot's own login environment must not override: for Compose, it comes before ``.env``."""

_UNPACK = f"""set -e; part=$1.$${PART}
rm -rf "$part"; mkdir -p "$part"; tar -x -f - -C "$part"
if diff -r "$1" "$part" > /dev/null 2>&1; then rm -rf "$part"; else rm -rf "$1"; mv "$part" "$1"; fi
find "${{1%/*}}" -maxdepth 1 -name '*{PART}' -mmin +60 -exec rm -rf {{}} +"""
"""A directory that is right stays: containers that run have its files mounted, and would keep the removed ones."""

_UNTIL_CLOSED = (
    'exec 3<&0; "$@" & child=$!'
    '; { while [ -n "$(timeout 45 head -c 1 <&3)" ]; do :; done; kill "$child"; } > /dev/null 2>&1 9>&- & wait "$child"'
)
"""Runs a command until it ends, or until standard input closes, as it does with the connection: nothing runs on.

The desktop's heartbeat comes there too (`fleet.ssh.channel.BEAT`): when a link is lost, nobody closes anything.
"""

_TURN = 240
"""Seconds to wait for another person's command on the same robot to end."""

_START = f"""exec 9>> {HOME}/lock
flock --wait {_TURN} 9 || {{ echo "somebody else's release is being started, and does not end" >&2; exit 1; }}
release=$1; shift; {_UNTIL_CLOSED} || exit
ln -sfn "releases/$release" {HOME}/current.new && mv -fT {HOME}/current.new {HOME}/current"""
"""One at a time: two `docker compose up` at once collide, and both fail."""

_NOTE = """mkdir -p .fleet
[ "$(tail -n 1 .fleet/history 2> /dev/null)" = "$1" ] || printf "%s\\n" "$1" >> .fleet/history"""


def compose(robot: Robot, release: str, *arguments: str) -> tuple[str, ...]:
    """The argv of ``docker compose`` in the directory of a release."""
    unset = (part for name in (*_OURS, *sorted(robot.environment)) for part in ("-u", name))
    return ("env", "-C", folder(release), *unset, "docker", "compose", *arguments)


def until_closed(argv: tuple[str, ...]) -> tuple[str, ...]:
    """The argv of a command that ends with the connection, which must hold its standard input open until then."""
    return ("sh", "-c", _UNTIL_CLOSED, "sh", *argv)


def write(release: Release) -> Step:
    """Write the directory of a release, whole or not at all."""
    return Step(
        title=f"write release {release.id} to ~/{folder(release.id)}",
        argv=("sh", "-c", _UNPACK, "sh", folder(release.id)),
        feed=Bytes(label=f"{len(release.files)} files", data=release.archive()),
        harmless=True,
        resumes=True,
    )


def start(robot: Robot, release: str, *, wait: int) -> Step:
    """Bring the containers to what a release says, wait until they are healthy (seconds), and make it the current one."""
    flags = (
        "--detach",
        "--wait",
        "--wait-timeout",
        str(wait),
        "--no-build",
        "--pull",
        "never",
        "--remove-orphans",
    )
    return Step(
        title=f"start release {release}",
        argv=("sh", "-c", _START, "sh", release, *compose(robot, release, "up", *flags)),
        limit=wait + _TURN + 60.0,
        until_closed=True,
        resumes=True,
    )


def stop(robot: Robot, release: str) -> Step:
    """Stop a release's containers; they stay stopped over a reboot."""
    return Step(title=f"stop release {release}", argv=compose(robot, release, "stop"), limit=90.0)


def last_words(robot: Robot, release: str) -> Step:
    """The last log lines of a release's containers."""
    return Step(
        title="show the last log lines",
        argv=compose(robot, release, "logs", "--no-color", "--no-log-prefix", "--tail", "8"),
        limit=20.0,
    )


def note(record: Record, *, when: str, what_came: str) -> Step:
    """One line of history; ``when`` is in ISO 8601."""
    line = Event(when=when, verb=record.verb, release=record.release, by=record.by, outcome=what_came)
    return Step(
        title="note it in the history", argv=("sh", "-c", _NOTE, "sh", str(line)), limit=20.0, resumes=True
    )
