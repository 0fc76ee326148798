"""Where does fleet keep things on a robot?

Plain files in the login's ``~/.fleet/``, readable and usable by hand::

    stacks/<name>/          one folder for each stack; the name is its Compose project name
      releases/<id>/        compose.yaml  project/  seeds/      `docker compose up -d` works in it
      current               -> releases/<id>
      data/                 what the robot's containers write: no release, rollback or prune touches it
      delivered             which files of data/ came from a desktop, and their digests
      history               one line for each ship, start, stop, rollback: when, what, release, by whom, outcome
      journal               what a command is doing to the containers; there only while it does
      stopped                `fab stop` was the last word: systemd does not start it (`boot: systemd`)
      dev/                  what `fab dev` has brought into the containers, by whom; there only until a release is back
      proved                the containers whose health check has passed in a swap
    receipts/               the manifests of the images that were sent, for a containerd store
    pulled/                 the manifests of those that Docker has pulled from a registry
    spool/                  uploads that were interrupted; empty otherwise
    stick/                  the work of `sh install` on a USB stick; empty otherwise
    runs/                   what goes on without a desktop: its script, for a power cut, and its output
    boot.sh                 starts stacks that systemd owns (`boot: systemd`)
    history                 what was done to the robot as a whole: `fab provision`
    lock, holder            held while containers are swapped or old releases removed; by whom

Every command starts in the login's home directory (`fleet.ssh.session`), so paths are relative to it. The scripts in
``onboard/`` repeat these names; a test compares them.
"""

from __future__ import annotations

HOME = ".fleet"

PART = ".part"
"""The ending of a release's directory while it is being written."""

STACKS = f"{HOME}/stacks"
HISTORY = f"{HOME}/history"
SPOOL = f"{HOME}/spool"
RECEIPTS = f"{HOME}/receipts"


def stack(name: str) -> str:
    """The folder of a stack."""
    return f"{STACKS}/{name}"


def folder(stack_name: str, release: str) -> str:
    """The folder of a release."""
    return f"{stack(stack_name)}/releases/{release}"


def data(stack_name: str) -> str:
    """The folder of what a stack's containers write."""
    return f"{stack(stack_name)}/data"
