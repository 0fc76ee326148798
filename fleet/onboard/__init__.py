"""What runs on a robot, as real files: shell scripts, one Python program, and the exit codes that they share."""

from __future__ import annotations

from importlib import resources

ENGLISH = "export LC_ALL=C"


def text(name: str) -> str:
    """The text of a script of this folder, such as ``probe.sh``: what ``sh -c`` on a robot is given.

    It travels with each command. Comments and indentation are a third of it, so they stay here, but for the first two
    lines, which say what the script does. Tools speak English to it, whatever the robot's language: scripts and
    `fleet.diagnosis` read their words.
    """
    lines = source(name).splitlines()
    code = (line.lstrip() for line in lines[2:])
    return "\n".join((*lines[:2], ENGLISH, *(line for line in code if line and not line.startswith("#")), ""))


def source(name: str) -> str:
    """The whole text of a file of this folder."""
    return (resources.files(__name__) / name).read_text(encoding="utf-8")
