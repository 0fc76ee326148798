"""The exit codes by which a program on a robot tells the desktop why it ended (BSD's sysexits.h has their names)."""

from __future__ import annotations

UNUSABLE = 65
"""Everything arrived, and the robot's Docker cannot use it: another strategy may help (EX_DATAERR)."""

MISSING = 69
"""Something that the program needs is not on this robot (EX_UNAVAILABLE)."""

BROKEN_OFF = 74
"""The input ended early, or a file cannot be read (EX_IOERR)."""

BUSY = 75
"""Another command holds the lock of this robot (EX_TEMPFAIL)."""
