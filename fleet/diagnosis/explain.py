"""What does a tool's output mean, and what cures it?

Text in, text out: the first of `fleet.diagnosis.known_errors` that the output shows, or else the tool's own last words.
"""

from __future__ import annotations

import re

from fleet.diagnosis.known_errors import KNOWN_ERRORS

LONGEST = 300
"""Characters of a tool's own words that are shown where no sign is known."""

_TAIL, _LINE = 32_000, 600
"""Characters that are looked at, of the output's end and of each line: some signs are slow on endless lines."""

_NOISE = re.compile(
    r"^(?:sudo: unable to resolve host|W: |WARNING: |\+ |debconf: |time=.* level=warning|See '|See \"|Run '"
    r"|exit status \d+$|For more help| *Container \S+ +\w+$| *Network \S+ +\w+$)"
)


def explain(output: str) -> tuple[str, str]:
    """What happened, as a clause without a full stop, and what cures it; "" where the output does not tell.

    Where no sign is known, the clause is the tool's own last words.
    """
    looked_at = "\n".join(line[:_LINE] for line in output[-_TAIL:].splitlines())
    for sign in KNOWN_ERRORS:
        if match := re.search(sign.pattern, looked_at, re.MULTILINE):
            found = [group.strip() for group in match.groups() if group]
            while len(found) < 2:
                found.append("")
            return _tidy(sign.what.format(*found)), sign.cure.format(*found)
    return _last_words(output), ""


def _last_words(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    telling = [line for line in lines if not _NOISE.match(line)] or lines
    return _tidy(telling[-1]) if telling else ""


def _tidy(said: str) -> str:
    clean = " ".join("".join(c if c.isprintable() else " " for c in said).split())
    clean = clean.replace(" ()", "").rstrip(" .:;")
    return clean if len(clean) <= LONGEST else clean[: LONGEST - 1] + "…"
