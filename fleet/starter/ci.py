"""Which commands does a CI service run for a project, and how does GitHub's workflow say them? Without effects.

The commands are those that a person types. What comes out is a bundle, which `fab ship --from` ships without building.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Literal

from fleet.platforms import PLATFORM_OF_MACHINE

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

BUNDLE = "bundle.tar"

_NATIVE = {"linux/arm64": "ubuntu-24.04-arm", "linux/amd64": "ubuntu-24.04"}
"""GitHub's machines on which a platform needs no emulation."""

_EMULATION = "sudo apt-get update && sudo apt-get install --yes qemu-user-static binfmt-support"

_MARK = "# Written by `fleet ci.github`. Digest of the lines below: "


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What CI is to make: bundles of ``hosts``, whose images are for ``platforms``.

    ``install`` is what pip installs fleet from, or "" if the project is a checkout of fleet. ``variables`` are the names
    that the inventory passes on from the environment. ``folder`` is the inventory's folder in the repository, or "".
    """

    hosts: str
    platforms: Collection[str]
    install: str = ""
    variables: Sequence[str] = ()
    folder: str = ""


def installing(wanted: Wanted) -> tuple[str, ...]:
    """The commands that install fleet."""
    if wanted.install:
        return (f"python -m pip install {shlex.quote(wanted.install)}",)
    return (
        "python -m pip install --require-hashes -r requirements.lock",
        "python -m pip install --no-deps .",
    )


def commands(wanted: Wanted) -> tuple[str, ...]:
    """The commands that check the inventory, build the images, and write the bundle."""
    hosts = "" if wanted.hosts == "all" else f" --hosts {shlex.quote(wanted.hosts)}"
    return (f"fleet inventory{hosts}", f"fleet build{hosts}", f"fleet bundle{hosts} --out {BUNDLE}")


def shell(wanted: Wanted) -> str:
    """A shell script for any CI service that has Docker and Python."""
    foreign = sorted(set(wanted.platforms) - {PLATFORM_OF_MACHINE["x86_64"]})
    lines = [
        "#!/bin/sh",
        f"# Check the inventory, build the images, and write {BUNDLE}. Needs Docker, and Python 3.11 as `python`.",
        *([f"# Images for {', '.join(foreign)} need emulation: {_EMULATION}"] if foreign else []),
        *([f"# Needs these variables: {', '.join(wanted.variables)}"] if wanted.variables else []),
        "set -eu",
        *([f"cd {shlex.quote(wanted.folder)}"] if wanted.folder else []),
        *installing(wanted),
        *commands(wanted),
    ]
    return "\n".join(lines) + "\n"


def github(wanted: Wanted, *, branch: str) -> str:
    """A workflow of GitHub Actions, with the digest of its lines in the first one."""
    runner = _runner(wanted.platforms)
    emulated = (
        runner not in {_NATIVE.get(platform) for platform in wanted.platforms}
        or len(set(wanted.platforms)) > 1
    )
    template = (resources.files(__package__) / "templates" / "github.yaml").read_text(encoding="utf-8")
    folder = f"{wanted.folder}/" if wanted.folder else ""
    settings = (
        f"    defaults:\n      run:\n        working-directory: {json.dumps(wanted.folder)}\n"
        if folder
        else ""
    )
    for place, text in {
        "@BRANCH@": json.dumps(branch),
        "@RUNNER@": runner,
        "@SETTINGS@": settings,
        "@STEPS@": "".join(_steps(wanted, emulated=emulated)),
        "@BUNDLE@": json.dumps(folder + BUNDLE),
    }.items():
        template = template.replace(place, text)
    return f"{_MARK}{_digest(template)}\n{template}"


def _runner(platforms: Collection[str]) -> str:
    """The machine that needs no emulation for the only platform; a mix is emulated on the usual one."""
    only = next(iter(platforms)) if len(set(platforms)) == 1 else ""
    return _NATIVE.get(only, _NATIVE["linux/amd64"])


def _steps(wanted: Wanted, *, emulated: bool) -> Iterator[str]:
    if emulated:
        yield f"      - run: {_EMULATION}\n"
    for command in installing(wanted):
        yield f"      - run: {_scalar(command)}\n"
    for command in commands(wanted):
        yield f"      - run: {_scalar(command)}\n"
        if wanted.variables:
            yield "        env:\n"
            yield from (f"          {name}: ${{{{ secrets.{name} }}}}\n" for name in wanted.variables)


def _scalar(command: str) -> str:
    """A command as YAML: plain where YAML reads it so."""
    risky = any(sign in command for sign in (": ", " #", "${{")) or command[0] in "\"'&*!|>%@`"
    return json.dumps(command) if risky else command


def state(there: str | None, new: str) -> Literal["new", "same", "ours", "theirs"]:
    """What a file that is there is: none, this very text, one that fleet wrote and nobody has changed, or a person's."""
    if there is None:
        return "new"
    if there == new:
        return "same"
    first, _, rest = there.partition("\n")
    return "ours" if first == _MARK + _digest(rest) else "theirs"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
