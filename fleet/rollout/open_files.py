"""How many files may this program have open? Each connection needs some, and ``ulimit -n`` may be low."""

from __future__ import annotations

import contextlib
import errno
import resource

from fleet.errors import DesktopError

CURE = "`ulimit -n 1024` in this shell, then run the same command again"

_OWN, _WHILE_CONNECTING, _AFTERWARDS = 24, 8, 2
"""Open files of the program itself; of a connection while it is made (`ssh -G`, the agent, known_hosts); of one that stands."""


def allow(robots: int, *, connecting: int) -> None:
    """Make sure that the files for so many robots at once may be opened, if so many of them are being connected to.

    Raises:
        DesktopError: not even this computer's hard limit allows it.

    """
    needed = _OWN + _WHILE_CONNECTING * min(robots, connecting) + _AFTERWARDS * robots
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        what = f"this computer allows {hard} open files, and {robots} connections at once need {needed}"
        raise DesktopError(what, cure=CURE)
    with contextlib.suppress(OSError, ValueError):  # then opening one too many is told
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


def refusal(problem: OSError) -> DesktopError | None:
    """Return the error in words if a file could not be opened because too many are; None for another error."""
    if problem.errno not in (errno.EMFILE, errno.ENFILE):
        return None
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return DesktopError(f"this computer allows {soft} open files, which are too few", cure=CURE)
