"""How does a shell complete what a person types? Scripts for bash, zsh and fish.

Verbs and flags are in the script, so the Tab key answers at once. Robots, groups and stacks are asked for when they are
needed: `fleet completion --names hosts`.
"""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.cli.selection import load
from fleet.errors import DesktopError, FleetError, UsageError
from fleet.platforms import NAMES as PLATFORMS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from fleet.cli.verb import Flag

SHELLS = ("bash", "zsh", "fish")

_MARK = "written by `fleet completion"
_BASH_COMPLETION = Path("/usr/share/bash-completion/bash_completion")
_NAMES = {"--hosts": "names:hosts", "--stack": "names:stack", "--inventory": "file"}


@dataclass(frozen=True, kw_only=True)
class Verbs:
    """All verbs: their summaries, and their flags as they are typed."""

    summaries: Mapping[str, str]
    flags: Mapping[str, Mapping[str, Flag]]


def shell(named: str) -> str:
    """Return the shell that was named, or the login's.

    Raises:
        UsageError: it is none that fleet knows.

    """
    found = named or Path(os.environ.get("SHELL", "")).name
    if found not in SHELLS:
        raise UsageError(
            f"fleet has no completion for {found}" if found else "which shell?",
            cure=f"fleet completion --shell {'|'.join(SHELLS)}",
        )
    return found


def names(kind: str, inventory: str) -> list[str]:
    """Return the names that ``--hosts`` or ``--stack`` takes; none if the inventory cannot be read.

    Raises:
        UsageError: ``kind`` is neither hosts nor stack.

    """
    if kind not in ("hosts", "stack"):
        raise UsageError(f"--names takes hosts or stack, not {kind}")
    try:
        fleet = load(inventory)
    except FleetError:
        return []
    if kind == "hosts":
        return [*dict.fromkeys((*fleet.robots, *fleet.groups))]
    stacks = (stack.files for robot in fleet.robots.values() for stack in robot.stacks)
    return [*dict.fromkeys(_stack_name(files) for files in stacks)]


def _stack_name(files: Sequence[Path]) -> str:
    """Return the project's name: that of the last file that has one, or of the folder. Compose would take too long."""
    from fleet.config import yamlfile  # noqa: PLC0415  `fab --list` does without

    for path in reversed(files):
        try:
            name = yamlfile.read(path, error=UsageError).value.get("name")
        except FleetError:
            continue
        if name:
            return str(name)
    return re.sub(r"[^a-z0-9_-]", "", files[0].parent.name.lower()).lstrip("_-")


def script(shell: str, verbs: Verbs) -> str:
    """Return the script for a shell."""
    text = (resources.files("fleet.cli") / "shells" / f"completion.{shell}").read_text(encoding="utf-8")
    for place, lines in _PARTS[shell](verbs).items():
        text = text.replace(f"@{place}@", "\n".join(lines))
    return text


def install(shell: str, text: str) -> Iterator[str]:
    """Write the script where its shell looks for it. Yields what a person should know.

    Raises:
        DesktopError: it cannot be written, or another program's file is there.

    """
    data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share")
    settings = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    places = {
        "bash": [data / "bash-completion/completions" / name for name in ("fleet", "fab")],
        "zsh": [data / "zsh/site-functions/_fleet"],
        "fish": [settings / "fish/completions" / name for name in ("fleet.fish", "fab.fish")],
    }
    for path in places[shell]:
        _write(path, text)
        yield f"wrote {path}"
    first = shlex.quote(str(places[shell][0]))
    if shell == "zsh":
        folder = shlex.quote(str(places[shell][0].parent))
        yield f"add to ~/.zshrc, before compinit: fpath=({folder} $fpath)"
    elif shell == "bash" and not _BASH_COMPLETION.exists():
        yield f"the package bash-completion is missing: install it, or add to ~/.bashrc: source {first}"
    yield "it works in new terminals"


def _write(path: Path, text: str) -> None:
    try:
        if path.exists() and _MARK not in path.read_text(encoding="utf-8", errors="replace"):
            raise DesktopError(f"{path} is there and is not fleet's", cure="move it away, or keep it")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise DesktopError(f"{path} cannot be written: {problem.strerror}") from None


def _choices(verb: str, flag: str) -> str:
    """What follows a flag: kind of names, ``file``, words, or ``text`` of a person's own."""
    from fleet.starter.project import DISTROS  # noqa: PLC0415  it loads pydantic, and `fab --list` does without

    words: dict[str, Iterable[str]] = {
        "--platform": PLATFORMS,
        "--distro": DISTROS,
        "--prefer": ("robot", "desktop"),
        "--shell": SHELLS,
    }
    if verb == "completion" and flag == "--names":
        return "hosts stack"
    return _NAMES.get(flag) or " ".join(words.get(flag, ())) or "text"


def _values(verbs: Verbs) -> list[str]:
    pairs = [(verb, flag) for verb, flags in verbs.flags.items() for flag in flags if flags[flag].takes_value]
    return [f'        "{verb} {flag}") echo {shlex.quote(_choices(verb, flag))} ;;' for verb, flag in pairs]


def _bash(verbs: Verbs) -> dict[str, list[str]]:
    flags = [f"        {verb}) echo {' '.join([*found, '--help'])} ;;" for verb, found in verbs.flags.items()]
    return {"VERBS": [" ".join(verbs.summaries)], "FLAGS": flags, "VALUES": _values(verbs)}


def _zsh(verbs: Verbs) -> dict[str, list[str]]:
    flags = [
        f"        {verb}) print -r -l -- {' '.join(shlex.quote(f'{flag}:{one.text}') for flag, one in found.items())} ;;"
        for verb, found in verbs.flags.items()
        if found
    ]
    described = [f"            {shlex.quote(f'{name}:{text}')}" for name, text in verbs.summaries.items()]
    return {"VERBS": described, "FLAGS": flags, "VALUES": _values(verbs)}


def _fish(verbs: Verbs) -> dict[str, list[str]]:
    said = [
        f"    complete --command $program --condition __fleet_has_no_verb --arguments {name} --description {_fished(text)}"
        for name, text in verbs.summaries.items()
    ]
    flags = [
        f"    complete --command $program --condition '__fleet_has_verb {verb}' --long-option {flag[2:]}"
        f" --description {_fished(one.text)}{_fish_values(verb, flag) if one.takes_value else ''}"
        for verb, found in verbs.flags.items()
        for flag, one in found.items()
    ]
    return {"VERBS": said, "FLAGS": flags}


def _fish_values(verb: str, flag: str) -> str:
    choices = _choices(verb, flag)
    if choices == "file":
        return " --require-parameter --force-files"
    if choices.startswith("names:"):
        return f" --exclusive --arguments '(__fleet_names {choices.removeprefix('names:')})'"
    return " --exclusive" + ("" if choices == "text" else f" --arguments {_fished(choices)}")


def _fished(text: str) -> str:
    """Quote text for fish, where only the backslash and the quote are special."""
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


_PARTS = {"bash": _bash, "zsh": _zsh, "fish": _fish}
