"""Does Debian's archive have what a test needs? While a mirror is renewed, its lists do not fit its index."""

from __future__ import annotations

import pytest

from fleet.errors import DesktopError
from fleet.images import debian_base

SUITE = "bookworm"


def base(platform: str) -> str:
    """The base for a platform; skips the test while apt cannot make one of an archive that contradicts itself."""
    try:
        return debian_base.ensure(SUITE, platform, say=print)
    except DesktopError as problem:
        if "being renewed" in problem.cure:
            pytest.skip(problem.what)
        raise
