from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet import terminal
from fleet.cli import json_output
from fleet.plan.step import Bytes, Plan, Step
from tests.support.samples import PI


@pytest.mark.parametrize(
    ("value", "read"),
    [
        ({"a": 1, "b": None, "c": True, "d": 1.5}, {"a": 1, "b": None, "c": True, "d": 1.5}),
        (("a", ["b"]), ["a", ["b"]]),
        ({1: "x"}, {"1": "x"}),
        (Path("/x/y"), "/x/y"),
        (b"secret", "6 bytes"),
        (Bytes(label="files", data=b"12"), {"label": "files", "data": "2 bytes"}),
        (frozenset(), "frozenset()"),
        ([], []),
    ],
)
def test_what_programs_read(value: object, read: object) -> None:
    """Values become their nearest in JSON; bytes their number, for they may hold secrets."""
    assert json.loads(json_output.text(value)) == read


def test_values_within_values() -> None:
    """A plan holds steps, which hold commands."""
    plan = Plan(robot=PI.name, summary="s", steps=(Step(title="t", argv=("a", "b")),))
    said = json.loads(json_output.text({"plans": [plan]}))
    assert said["plans"][0]["steps"][0]["argv"] == ["a", "b"]
    assert said["plans"][0]["record"] is None


def test_letters_stay_letters() -> None:
    """People read it as well."""
    assert json_output.text("Grüße ☃") == '"Grüße ☃"'


@given(st.text())
def test_text_of_a_robot_does_not_steer_a_terminal(said: str) -> None:
    """Programs read what it said; people who look at it see letters."""
    written = json_output.text({said: [said]})
    assert json.loads(written) == {said: [said]}
    assert terminal.plain(written) == written
    written.encode()


def test_the_worst_of_it() -> None:
    """A control sequence in one byte, a change of direction, half a letter."""
    assert json_output.text("\x9b31m\u202e\x1b\ud800") == r'"\u009b31m\u202e\u001b\ud800"'
