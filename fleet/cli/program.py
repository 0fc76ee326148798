"""Which command did the person type, ``fab`` or ``fleet``? Messages name the one that works here."""

from __future__ import annotations

import re
import sys
from pathlib import Path

_FAB = re.compile(r"(?<![\w./-])fab (?=[a-z-]|VERB)")


def name() -> str:
    """Return the name of the program, as it was typed."""
    return Path(sys.argv[0]).name


def typed(text: str) -> str:
    """Return a message in which ``fab ship`` is ``fleet ship``, if that was typed: `fab` alone needs a fabfile."""
    return _FAB.sub("fleet ", text) if name() == "fleet" else text
