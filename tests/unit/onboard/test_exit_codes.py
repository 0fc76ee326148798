from __future__ import annotations

import os
import re

from fleet import onboard
from fleet.onboard import exit_codes, rebuild_layer


def test_the_codes_are_those_of_sysexits() -> None:
    """Their names are known, and a shell gives none of them to a command that fails by itself."""
    assert exit_codes.UNUSABLE == os.EX_DATAERR
    assert exit_codes.MISSING == os.EX_UNAVAILABLE
    assert exit_codes.BROKEN_OFF == os.EX_IOERR
    assert exit_codes.BUSY == os.EX_TEMPFAIL


def test_the_program_that_rebuilds_layers_has_the_same_codes() -> None:
    """It stands alone on a robot, so it cannot import them."""
    for name in ("UNUSABLE", "MISSING", "BROKEN_OFF"):
        assert getattr(rebuild_layer, name) == getattr(exit_codes, name)


def test_the_receiving_script_has_the_same_codes() -> None:
    """The desktop reads them to decide whether to resume, to wait or to try another strategy."""
    (line,) = re.findall("^unusable=.*", onboard.source("receive.sh"), re.MULTILINE)
    codes = dict(word.split("=") for word in line.partition("#")[0].split())
    assert {name.upper(): int(code) for name, code in codes.items()} == {
        name: getattr(exit_codes, name) for name in ("UNUSABLE", "BROKEN_OFF", "BUSY")
    }
