"""Which commands does a CI service run for a project, and how does GitHub's workflow say them? Without effects.

The commands are those that a person types. What comes out is a bundle, or images in a registry; `fab ship --from` ships
either without building.
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

_ON_PUSH = "        if: github.event_name == 'push' # a pull request is built only\n"

_KEEP = f"""\
      - uses: actions/upload-artifact@ea165f8d65b6e75b540449e92b4886f43607fa02 # v4.6.2
{_ON_PUSH}        with:
          name: bundle
          path: @BUNDLE@
          if-no-files-found: error
          retention-days: 7
"""

_GITHUBS = "ghcr.io"
"""GitHub's own registry: the workflow's token is a login for it."""

_LOGIN_OF_GITHUB = ("${{ github.actor }}", "${{ secrets.GITHUB_TOKEN }}")
_LOGIN = ("${{ secrets.REGISTRY_USER }}", "${{ secrets.REGISTRY_TOKEN }}")

_PACKAGES = "      packages: write # to push to ghcr.io\n"

_MARK = "# Written by `fleet ci.github`. Digest of the lines below: "


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What CI is to make of ``hosts``, whose images are for ``platforms``: a bundle, or the images in the registry ``to``.

    ``install`` is what pip installs fleet from, or "" if the project is a checkout of fleet. ``variables`` are the names
    that the inventory passes on from the environment. ``folder`` is the inventory's folder in the repository, or "".
    """

    hosts: str
    platforms: Collection[str]
    install: str = ""
    variables: Sequence[str] = ()
    folder: str = ""
    to: str = ""

    @property
    def registry(self) -> str:
        """The registry's host, as `docker login` wants it."""
        return self.to.partition("/")[0]


def installing(wanted: Wanted) -> tuple[str, ...]:
    """The commands that install fleet."""
    if wanted.install:
        return (f"python -m pip install {shlex.quote(wanted.install)}",)
    return (
        "python -m pip install --require-hashes -r requirements.lock",
        "python -m pip install --no-deps .",
    )


def commands(wanted: Wanted) -> tuple[str, ...]:
    """The commands that check the inventory, build the images, and write the bundle or push them."""
    hosts = "" if wanted.hosts == "all" else f" --hosts {shlex.quote(wanted.hosts)}"
    last = (
        f"fleet push{hosts} --to {shlex.quote(wanted.to)}"
        if wanted.to
        else f"fleet bundle{hosts} --out {BUNDLE}"
    )
    return (f"fleet inventory{hosts}", f"fleet build{hosts}", last)


def shell(wanted: Wanted) -> str:
    """A shell script for any CI service that has Docker and Python."""
    foreign = sorted(set(wanted.platforms) - {PLATFORM_OF_MACHINE["x86_64"]})
    lines = [
        "#!/bin/sh",
        f"# Check the inventory, build the images, and {_makes(wanted)}. Needs Docker, and Python 3.11 as `python`.",
        *([f"# Before: docker login {wanted.registry}"] if wanted.to else []),
        *([f"# Images for {', '.join(foreign)} need emulation: {_EMULATION}"] if foreign else []),
        *([f"# Needs these variables: {', '.join(wanted.variables)}"] if wanted.variables else []),
        "set -eu",
        *([f"cd {shlex.quote(wanted.folder)}"] if wanted.folder else []),
        *installing(wanted),
        *commands(wanted),
    ]
    return "\n".join(lines) + "\n"


def _makes(wanted: Wanted) -> str:
    return f"push them to {wanted.to}" if wanted.to else f"write {BUNDLE}"


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
        "@JOB@": "images" if wanted.to else "bundle",
        "@MAKES@": "push them" if wanted.to else "write the bundle",
        "@BRANCH@": json.dumps(branch),
        "@PERMISSIONS@": _PACKAGES if wanted.registry == _GITHUBS else "",
        "@RUNNER@": runner,
        "@SETTINGS@": settings,
        "@STEPS@": "".join(_steps(wanted, emulated=emulated)),
        "@PUBLISH@": "" if wanted.to else _KEEP.replace("@BUNDLE@", json.dumps(folder + BUNDLE)),
    }.items():
        template = template.replace(place, text)
    template = template.rstrip("\n") + "\n"  # each step ends its own line
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
    *before, last = commands(wanted)
    for command in before:
        yield f"      - run: {_scalar(command)}\n"
        yield from _environment(wanted)
    if wanted.to:
        yield f"      - run: {_scalar(_login(wanted))}\n{_ON_PUSH}"
        user, password = _LOGIN_OF_GITHUB if wanted.registry == _GITHUBS else _LOGIN
        yield f"        env:\n          REGISTRY_USER: {user}\n          REGISTRY_TOKEN: {password}\n"
    yield f"      - run: {_scalar(last)}\n{_ON_PUSH if wanted.to else ''}"
    yield from _environment(wanted)


def _login(wanted: Wanted) -> str:
    user = '--username "$REGISTRY_USER" --password-stdin'
    return f"printenv REGISTRY_TOKEN | docker login {user} {shlex.quote(wanted.registry)}"


def login_secrets(wanted: Wanted) -> tuple[str, ...]:
    """The secrets that the login of a registry needs; GitHub's own needs none."""
    return ("REGISTRY_USER", "REGISTRY_TOKEN") if wanted.to and wanted.registry != _GITHUBS else ()


def _environment(wanted: Wanted) -> Iterator[str]:
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
