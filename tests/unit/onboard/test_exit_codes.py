from __future__ import annotations

import os

from fleet.onboard import exit_codes


def test_the_codes_are_those_of_sysexits() -> None:
    """Their names are known, and a shell gives none of them to a command that fails by itself."""
    assert exit_codes.UNUSABLE == os.EX_DATAERR
    assert exit_codes.MISSING == os.EX_UNAVAILABLE
    assert exit_codes.BROKEN_OFF == os.EX_IOERR
    assert exit_codes.BUSY == os.EX_TEMPFAIL
