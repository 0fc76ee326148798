"""What does a tool's error output mean, and how is the error fixed?

The first match of `fleet.diagnosis.known_errors` counts. Without one, the last line of the output is shown.
"""

from __future__ import annotations

import re

from fleet.diagnosis.known_errors import KNOWN_ERRORS

LONGEST = 300
"""Characters of an unknown error's last line that are shown."""

_TAIL, _LINE = 32_000, 600
"""Characters that are searched, of the output's end and of each line: some patterns are slow on endless lines."""

_NOISE = re.compile(
    r"^(?:sudo: unable to resolve host|W: |WARNING: |\+ |debconf: |time=.* level=warning|See '|See \"|Run '"
    r"|exit status \d+$|For more help| *Container \S+ +\w+$| *Network \S+ +\w+$)"
)


def explain(output: str) -> tuple[str, str]:
    """Return what happened, as a clause without a full stop, and the cure; the cure is empty if it is unknown.

    For an unknown error the clause is the last line of the output.
    """
    searched = "\n".join(line[:_LINE] for line in output[-_TAIL:].splitlines())
    for known in KNOWN_ERRORS:
        if match := re.search(known.pattern, searched, re.MULTILINE):
            groups = [group.strip() for group in match.groups() if group]
            while len(groups) < 2:
                groups.append("")
            return _tidy(known.what.format(*groups)), known.cure.format(*groups)
    return _last_line(output), ""


def _last_line(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    telling = [line for line in lines if not _NOISE.match(line)] or lines
    return _tidy(telling[-1]) if telling else ""


def _tidy(text: str) -> str:
    clean = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    clean = clean.replace(" ()", "").rstrip(" .:;")
    return clean if len(clean) <= LONGEST else clean[: LONGEST - 1] + "…"
