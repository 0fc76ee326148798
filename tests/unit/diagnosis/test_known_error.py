from __future__ import annotations

from fleet.diagnosis.known_error import KnownError

KNOWN = KnownError("(.+): gone", "{0} is gone", "install {package}", {"ship": "wait for {0}"})


def test_the_cure_knows_the_verb_that_runs() -> None:
    """And the package of the command that is missing; none if it is not known."""
    assert KNOWN.clause(["flock", ""]) == "flock is gone"
    assert KNOWN.cure_during("provision", ["flock", ""]) == "install util-linux"
    assert KNOWN.cure_during("ship", ["flock", ""]) == "wait for flock"
    assert KNOWN.cure_during("", ["nosuch", ""]) == "install "
