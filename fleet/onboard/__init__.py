"""What runs on a robot, as real files: shell scripts, one Python program, and the exit codes that they share."""

from __future__ import annotations

from importlib import resources


def text(name: str) -> str:
    """The text of a file of this folder, such as ``probe.sh``: what ``sh -c`` on a robot is given."""
    return (resources.files(__name__) / name).read_text(encoding="utf-8")
