"""Where does fleet keep things on a robot?

Plain files in the login's ``~/.fleet/``, readable and usable by hand::

    releases/<id>/   compose.yaml  compose.override.yaml  .env  files/    `docker compose up -d` works in it
    current          -> releases/<id>
    receipts/        the manifests of the images that were sent, for a containerd store
    spool/           uploads that were interrupted; empty otherwise
    history          one line for each ship, start, stop, rollback: when, what, release, by whom, outcome
    lock             held while a release starts

Every command starts in the login's home directory, so paths are relative to it. The scripts in ``onboard/`` repeat these
names; a test compares them.
"""

from __future__ import annotations

HOME = ".fleet"

PART = ".part"
"""The ending of a release's directory while it is being written."""

HISTORY = f"{HOME}/history"
SPOOL = f"{HOME}/spool"
RECEIPTS = f"{HOME}/receipts"


def folder(release: str) -> str:
    """The directory of a release."""
    return f"{HOME}/releases/{release}"
