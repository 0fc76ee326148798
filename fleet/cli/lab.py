"""Which verbs does the lab have? ``fab lab.up``, ``lab.down``, ``lab.list``."""

from __future__ import annotations

from pathlib import Path

from fleet.cli.console import Screen
from fleet.cli.verb import verb
from fleet.lab import lifecycle

DIRECTORY = Path(".lab")
"""Where the lab keeps its key and its inventory; ``inventory.yaml`` includes it."""


@verb({"count": "number of virtual Pis; default: 3"})
def up(count: int = 3) -> None:
    """Start virtual Pis on this computer to try things on.

    Each starts like a fresh Raspberry Pi OS: systemd, sshd, sudo, a user `pi`, no Docker. Running ones are left alone.
    """
    lifecycle.up(count, directory=DIRECTORY, say=Screen().say)


@verb()
def down() -> None:
    """Remove the virtual Pis and all their data."""
    lifecycle.down(directory=DIRECTORY, say=Screen().say)


@verb(name="list", looks=True)
def list_(json: bool = False) -> None:
    """List the virtual Pis."""
    screen, pis = Screen(), lifecycle.list_()
    if json:
        screen.json(pis)
    else:
        columns = ("name", "address", "state", "platform", "container")
        screen.table(columns, [[(str(getattr(pi, column)), "") for column in columns] for pi in pis])


VERBS = (up, down, list_)
