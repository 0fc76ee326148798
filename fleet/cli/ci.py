"""Which verbs bring a project into CI? ``fab ci.github``, ``fab ci.shell``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.cli.console import Screen
from fleet.cli.registry_access import address
from fleet.cli.selection import select
from fleet.cli.verb import verb
from fleet.errors import DesktopError, UsageError
from fleet.starter import ci

if TYPE_CHECKING:
    from fleet.config.inventory import Inventory, Robot

WORKFLOW = Path(".github/workflows/robots.yml")

_INSTALL = "what pip installs fleet from in CI: a git address with a commit, or a wheel in your repository"
_TO = "push the images to this registry, such as ghcr.io/OWNER/robots, in place of a bundle"


@verb({"install": _INSTALL, "to": _TO, "branch": "the branch that is published; default: main"})
def github(
    install: str = "",
    to: str = "",
    branch: str = "main",
    hosts: str = "all",
    dry: bool = False,
    inventory: str = "",
) -> None:
    """Write a GitHub workflow that builds the images.

    Each push to the branch is built on GitHub's computers, by the commands of `fab ci.shell`, and kept: as a bundle for 7
    days, or with --to in a registry. `fab ship --from` ships either, without building here. Pull requests are built only.
    A workflow that you have changed is not overwritten. --dry prints it.
    """
    screen, (found, robots) = Screen(), select(inventory, hosts)
    root = _repository(found.path)
    wanted = _wanted(found, robots, hosts=hosts, install=install, to=to, root=root)
    text, path = ci.github(wanted, branch=branch), root / WORKFLOW
    if dry:
        sys.stdout.write(text)
        return
    screen.lines([_write(path, text)])
    for note in _notes(wanted):
        screen.say(note)


@verb({"install": _INSTALL, "to": _TO}, looks=True)
def shell(install: str = "", to: str = "", hosts: str = "all", inventory: str = "") -> None:
    """Print a script for any CI that builds the images.

    `fab ci.shell > build.sh`: it checks the inventory, builds the images, and writes bundle.tar, or with --to pushes them to
    a registry. `fab ship --from` ships either, on any computer that has the inventory.
    """
    found, robots = select(inventory, hosts)
    root = _repository(found.path)
    sys.stdout.write(ci.shell(_wanted(found, robots, hosts=hosts, install=install, to=to, root=root)))


def _repository(inventory: Path) -> Path:
    """The folder of the repository that an inventory is in; without one, the inventory's own."""
    own = inventory.resolve().parent
    return next((folder for folder in (own, *own.parents) if (folder / ".git").exists()), own)


def _wanted(
    inventory: Inventory, robots: tuple[Robot, ...], *, hosts: str, install: str, to: str, root: Path
) -> ci.Wanted:
    folder = inventory.path.resolve().parent
    if not install and not (folder / "fleet" / "onboard").is_dir():
        raise UsageError(
            "CI must install fleet, and this project does not say from where",
            cure="--install git+https://github.com/OWNER/fleet@COMMIT, or --install tools/fleet-1.0-py3-none-any.whl",
        )
    names = dict.fromkeys(name for robot in robots for name in robot.pass_environment)
    return ci.Wanted(
        hosts=hosts,
        platforms=sorted({robot.platform for robot in robots}),
        install=install,
        variables=tuple(names),
        folder="" if folder == root else folder.relative_to(root).as_posix(),
        to=address(to) if to else "",
    )


def _write(path: Path, text: str) -> str:
    """Write the workflow, unless a person has changed it; what was done, in words."""
    try:
        there = path.read_bytes().decode(errors="replace") if path.exists() else None
        state = ci.state(there, text)
        if state == "theirs":
            raise UsageError(
                f"{path} was changed since fleet wrote it, or somebody else wrote it: it is kept",
                cure="move it away, or take from `fab ci.github --dry` what you need",
            )
        if state != "same":
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise DesktopError(f"{path} cannot be written: {problem.strerror}") from None
    return f"{path} is as it should be" if state == "same" else f"wrote {path}"


def _notes(wanted: ci.Wanted) -> list[str]:
    names = [*wanted.variables, *ci.login_secrets(wanted)]
    secrets = [f"set these secrets in the repository on GitHub: {', '.join(names)}"] if names else []
    if wanted.to:
        return [
            *secrets,
            "next: push it; its log has the images' names, for fleet ship --from NAME@sha256:...",
        ]
    return [
        "note: a bundle holds the robots' settings and secrets in plain text; who may read the repository can download it",
        *secrets,
        f"next: push it; then gh run download --name bundle, and fleet ship --from {ci.BUNDLE}",
    ]


VERBS = (github, shell)
