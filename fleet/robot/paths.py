"""Where does fleet keep things on a robot?"""

from __future__ import annotations

HOME = ".fleet"

PART = ".part"
"""How the name of a release's directory ends while it is being written."""


def folder(release: str) -> str:
    """The directory of a release."""
    return f"{HOME}/releases/{release}"
