"""Which parts of a robot's output may reach the user's terminal?

Programs print control sequences: colours, and others that change the window title, move the cursor over other lines or
make the terminal send input. Only text and colours pass.
"""

from __future__ import annotations

import re

UNSAFE = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u206f\ud800-\udfff"
"""In a class of a regular expression: control characters but tab and line end, line separators, changes of direction, halves of letters."""

# ECMA-48 sequences, whole where they are; then single characters.
_CONTROL = re.compile(
    r"(?:\x1b[\]PX^_]|[\x9d\x90\x98\x9e\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?"
    r"|(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]"
    r"|\x1b[ -/]*[0-~]"
    rf"|[{UNSAFE}]"
)
_COLOUR = re.compile(r"\x1b\[[0-9;]{0,40}m")


def plain(text: str) -> str:
    """Return the text without control sequences; line ends and tabs stay."""
    return _CONTROL.sub("", text)


def coloured(text: str) -> str:
    """Return the text without control sequences other than colours."""
    return _CONTROL.sub(lambda match: match[0] if _COLOUR.fullmatch(match[0]) else "", text)
