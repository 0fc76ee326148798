from __future__ import annotations

import pytest
from pydantic import ValidationError

from fleet.config.model import Frozen


class Value(Frozen):
    number: int = 0


def test_a_value_knows_no_other_keys_and_guesses_nothing() -> None:
    """A misspelt key and a number in quotes are mistakes, and are told."""
    for wrong in ({"other": 1}, {"number": "1"}):
        with pytest.raises(ValidationError):
            Value.model_validate(wrong)
    assert Value.model_validate({"number": 1}).number == 1


def test_a_value_does_not_change() -> None:
    """It is shared by threads."""
    with pytest.raises(ValidationError):
        Value().number = 1
