"""What does ``fab`` offer? The page for people who typed no verb, or asked for help."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

PURPOSES: Mapping[str, Sequence[str]] = {
    "Set up": ("init", "inventory", "card", "await", "find", "trust", "provision", "completion"),
    "Ship": (
        "build",
        "ship",
        "dev",
        "rollback",
        "prune",
        "start",
        "stop",
        "restart",
        "remove",
        "bundle",
        "push",
    ),
    "Look": ("status", "history", "logs", "topics", "listen", "run", "shell"),
    "Build in CI": ("ci.github", "ci.shell"),
    "Lab: virtual robots on this computer": ("lab.up", "lab.list", "lab.down"),
}
"""Every verb but `help`, by what a person wants."""

SHARED_FLAGS = {
    "--hosts NAMES": "robots, groups and wildcards, separated by commas; default: all",
    "--dry": "show what would be done, and change nothing",
    "--json": "print the result as JSON",
    "--inventory FILE": "default: $FLEET_INVENTORY, or the nearest inventory.yaml",
    "--help": "explain a verb and all its flags",
}

_TEMPLATE = """\
fleet puts Docker and ROS on robots over SSH.

Usage: {program} VERB [--hosts NAMES] [other flags of the verb]

{first}{verbs}

Flags that most verbs share; they come after the verb
{flags}

Examples
  {program} ship --help               explain `ship` and all its flags
  {program} ship --hosts pi1,lidar    ship to the robot pi1 and the group lidar
  {program} run -- uptime             run a command on all robots

Documentation: README.md and docs/ in the project's repository
"""


_FIRST = {
    "init": "write the files of a project for the ROS packages here",
    "init --example": "or write an example: a node that publishes the time",
    "lab.up": "start virtual robots, if you have none at hand",
}
"""What to do in a folder without an inventory."""


def page(summaries: Mapping[str, str], *, program: str, new: bool = False) -> str:
    """Return the page. ``summaries`` has one line for each verb, ``program`` is the name that was typed.

    ``new``: the person has no inventory here, and is told how to begin.
    """
    steps = "".join(f"  {program} {words:20}{text}\n" for words, text in _FIRST.items())
    first = f"There is no inventory in this folder. To begin\n{steps}\n" if new else ""
    verbs = "\n\n".join(
        f"{purpose}\n" + _columns({name: summaries[name] for name in names})
        for purpose, names in PURPOSES.items()
    )
    return _TEMPLATE.format(program=program, first=first, verbs=verbs, flags=_columns(SHARED_FLAGS))


def _columns(rows: Mapping[str, str]) -> str:
    return "\n".join(f"  {name:18}{text}" for name, text in rows.items())
