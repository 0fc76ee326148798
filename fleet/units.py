"""How are bytes and seconds written for people?"""

from __future__ import annotations


def human_bytes(count: float) -> str:
    """A number of bytes in decimal units: ``242 MB``."""
    if count < 1000:
        return f"{count:.0f} B"
    for unit in ("kB", "MB"):
        count /= 1000
        if count < 999.5:  # otherwise it would be rounded to 1000 of this unit
            return f"{count:.1f} {unit}" if count < 9.95 else f"{count:.0f} {unit}"
    return f"{count / 1000:.1f} GB"


def human_seconds(seconds: float) -> str:
    """A time span in one unit: ``8 s``, ``3 min``, ``5 h``, ``2 d``."""
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"
