"""What does a refusal of Compose mean, and which line is it about? Pure: its words in, plain English out."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fleet.config import yamlfile


def _required(found: re.Match[str]) -> str:
    return f"{found[1]}: the required variable {found[2]} is not set" + (f" ({found[3]})" if found[3] else "")


def _circle(found: re.Match[str]) -> str:
    names = re.findall(r"(?:extends )?(\S+) in ", found[1])
    if len(names) > 1 and names[0] == names[-1]:  # Compose begins anywhere in the circle
        first = names.index(min(names))
        names = [*names[first:-1], *names[: first + 1]]
    return f"services extend each other in a circle: {' -> '.join(names)}"


_WORDINGS: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"error while interpolating (\S+): required variable (\S+) is missing a value(?:: (.+))?", _required),
    (r"invalid interpolation format for (\S+)\.\n[^\n]*\n?(.*)", r"\1: `\2` is not a variable"),
    (r"^Circular reference:(.*)", _circle),
    (r"^dependency cycle detected: (.*)", r"services depend on each other in a circle: \1"),
    (
        r"decoding failed due to the following error\(s\):\s*'services\[(.+?)\]([^']*)' (.*)",
        r"services.\1\2: \3",
    ),
    (r"^\s*additional propert(?:y|ies) (.+) not allowed", r"\1: there is no such key"),
    (r" false schema", ": there is no such key"),
    (r" has neither an image nor a build context specified", " has neither `image:` nor `build:`"),
    (r" declares mutually exclusive (`.*`)", r" cannot have both \1"),
    (r"^project name must not be empty", "the stack has no name, and its folder's name has no usable letter"),
    (r"^env file (\S+) not found: .*", r"the env_file `\1`: no such file"),
    (r"^open (.*): no such file or directory", r"`\1`: no such file"),
    (r"^invalid hostPort: (.*)", r"`\1` is not a port of the host"),
    (r"failed to access repository at (\S+):", r"there is no repository at `\1`:"),
    (r": invalid compose project$", ""),
)
"""What Compose says, and the same in plain English."""


def sentence(text: str) -> str:
    """One sentence in plain English."""
    for pattern, replacement in _WORDINGS:
        text = re.sub(pattern, replacement, text, flags=re.DOTALL)
    return " ".join(text.split())


_PATH = re.compile(
    r"\b(?:services|volumes|networks|configs|secrets|include|name|x-)[.\[][\w.\[\]-]*|^\w+(?= must be)"
)
_SERVICE = re.compile(r"""\bservice ["']?([\w.-]+)""")
_WORD = re.compile(r"""["'`]([^"'`]+)["'`]|(\S+)$""")


def place_of(message: str, documents: Sequence[yamlfile.Document]) -> str:
    """``file:line`` of the key that a message names, or of the text that it quotes."""
    for found in _PATH.finditer(message):
        steps = [step for step in re.split(r"[.\[\]]+", found[0].rstrip(".")) if step]
        depth, line, path = max((*nearest(document, steps), document.path) for document in documents)
        if depth:
            return f"{path}:{line}"
    service = _SERVICE.search(message)
    for document in documents:
        depth, line = nearest(document, ("services", service[1])) if service else (0, 1)
        lines = document.source.splitlines()
        for found in reversed([*_WORD.finditer(message)]):
            name = PurePosixPath(found[1] or found[2])
            word = re.compile(rf"(?<![\w.-])(?:{re.escape(str(name))}|{re.escape(name.name)})(?![\w.-])")
            for number in range(line if depth == 2 else 1, len(lines) + 1):
                if word.search(lines[number - 1].partition(" #")[0]):
                    return f"{document.path}:{number}"
        if depth == 2:
            return f"{document.path}:{line}"
    return ""


def nearest(document: yamlfile.Document, steps: Sequence[str]) -> tuple[int, int]:
    """How many of the steps a document has, and the line of the last one."""
    entry, depth = document.root, 0
    for step in steps:
        key: str | int = int(step) if step.isdecimal() and step not in entry.inside else step
        if key not in entry.inside:
            break
        entry, depth = entry.inside[key], depth + 1
    return depth, entry.line


_CURES = (
    (
        "the required variable",
        "set it under `environment:` of the robot in the inventory, or in the project's .env",
    ),
    ("there is no such key", "see docs.docker.com/reference/compose-file"),
    ("no such file", "make the file, or correct its name"),
    ("not found", "make the file, or correct its name"),
    ("is not a variable", "write `${NAME}`, or `$$` for a dollar sign"),
    ("in a circle", "remove one of them"),
    ("the stack has no name", "write `name:` at the top of the file"),
    ("neither `image:` nor `build:`", "name an image"),
    ("undefined", "define it in the file, or correct its name"),
    ("cannot have both", "remove one of them"),
    ("port of the host", "a port is a number from 1 to 65535"),
    ("duration", "write a duration such as `1m30s`"),
    ("must be", "see docs.docker.com/reference/compose-file"),
    ("no repository at", "see whether `git clone` of it works here"),
)


def cure_of(message: str) -> str:
    """What to do about a refusal, from its sentence."""
    return next(
        (cure for words, cure in _CURES if words in message), "see what `docker compose config` says here"
    )
