"""The step that writes a file on a robot, whole or not at all: with its digest, because a lost link ends an input early."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.plan.step import Bytes, Step
from fleet.provision.sudo import as_root

if TYPE_CHECKING:
    from fleet.robot.facts import Facts


def step(
    title: str,
    path: str,
    data: bytes,
    *,
    label: str,
    root: Facts | None = None,
    keep: bool = False,
    secret: bool = False,
    limit: float = 20.0,
) -> Step:
    """Write ``data`` to ``path``; as root if the facts of the robot are given as ``root``.

    ``keep``: the file is a person's too, and what was there the first time stays as ``PATH.before-fleet``.
    ``secret``: only its owner may read it. ``limit`` is in seconds.
    """
    run = ("sh", "-c", onboard.text("replace_file.sh"), "replace_file")
    argv = (*run, path, digest(data), *(("secret",) if secret else ("keep",) if keep else ()))
    return Step(
        title=title,
        argv=as_root(root, *argv) if root else argv,
        feed=Bytes(label=label, data=data),
        limit=limit,
    )


def digest(data: bytes) -> str:
    """The SHA-256 of ``data`` in hex, as the robot compares it."""
    return hashlib.sha256(data).hexdigest()
