"""What does a tool's error output mean, and how is the error fixed?

The first match of `fleet.diagnosis.known_errors` counts. Without one, the last line of the output is shown.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from fleet.diagnosis.known_errors import KNOWN_ERRORS

if TYPE_CHECKING:
    from fleet.diagnosis.known_error import KnownError

LONGEST = 300
"""Characters of an unknown error's last line that are shown."""

NOT_FOUND = 127
"""The exit code of shells, `env` and `timeout` for a command that does not exist."""

_TAIL, _LINE = 32_000, 600
"""Characters that are searched, of the output's end and of each line: some patterns are slow on endless lines."""

_OURS = ("note: ", "now: ")
"""How lines begin that scripts of `fleet.onboard` write for the person who waits."""

_NOISE = re.compile(
    r"^(?:sudo: unable to resolve host|W: |WARNING: |\+ |debconf: |time=.* level=warning|See '|See \"|Run '"
    r"|exit status \d+$|note: |now: |For more help| *Container \S+ +\w+$| *Network \S+ +\w+$)"
)


def explain(output: str, *, code: int = 1, verb: str = "", details: str = "") -> tuple[str, str]:
    """Return what happened, as a clause without a full stop, and the cure; the cure is empty if it is unknown.

    ``code`` is the exit code. ``verb`` is the verb that runs: no cure tells a user to run it. ``details`` is what the
    robot was asked after the failure, such as the end of a journal: it counts if the output itself gives no reason. For an
    unknown error the clause is the last line of the output.
    """
    found = _find(output)
    what = _clause(*found) if found else _last_line(output)
    if details and (found is None or found[0].vague) and (further := _find(details)):
        what, found = _joined(what, _clause(*further)), further
    if found:
        known, groups = found
        return what, known.cure_during(verb, groups)
    if code == NOT_FOUND:
        said = what or "exit code 127"
        return f"a command is missing on the robot ({said})", "install the package that has it on the robot"
    return what, ""


def _find(output: str) -> tuple[KnownError, list[str]] | None:
    """The first known error in an output, and the groups of its pattern that matched: two of them or more."""
    lines = output[-_TAIL:].splitlines()
    searched = "\n".join(line[:_LINE] for line in lines if not line.startswith(_OURS))
    for known in KNOWN_ERRORS:
        if match := re.search(known.pattern, searched, re.MULTILINE):
            groups = [group.strip() for group in match.groups() if group]
            return known, groups + [""] * (2 - len(groups))
    return None


def _clause(known: KnownError, groups: list[str]) -> str:
    return _tidy(known.clause(groups))


def _joined(first: str, second: str) -> str:
    """Two clauses about one failure, without saying the same thing twice."""
    return second if not first or second.startswith(first) else f"{first}: {second}"


def _last_line(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    telling = [line for line in lines if not _NOISE.match(line)] or lines
    return _tidy(telling[-1]) if telling else ""


def _tidy(text: str) -> str:
    clean = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    clean = clean.replace(" ()", "").rstrip(" .:;")
    return clean if len(clean) <= LONGEST else clean[: LONGEST - 1] + "…"
