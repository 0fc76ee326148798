from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.plan import compose_steps
from fleet.plan.step import Record
from fleet.robot.history import history
from tests.support.robot_shell import do

if TYPE_CHECKING:
    from pathlib import Path

RECORD = Record(verb="ship", release="3f2a9c1b5d0e", by="tim@desktop")


def test_an_event_is_one_line_whatever_it_says(home: Path) -> None:
    """Reasons have newlines, tabs and quotes in them, and the history is read by lines and tabs."""
    events = ('failed: "a"\n\tb $(touch /tmp/x) %s \\n', "done")
    for what in events:
        assert do(compose_steps.note(RECORD, when="2026-11-23T12:00:00Z", outcome=what), home).returncode == 0
    text = (home / ".fleet/history").read_text()
    first = "2026-11-23T12:00:00Z\tship\t3f2a9c1b5d0e\ttim@desktop\t"
    assert text == f'{first}failed: "a" b $(touch /tmp/x) %s \\n\n{first}done\n'
    assert [event.outcome for event in history(tuple(text.splitlines()))] == [
        'failed: "a" b $(touch /tmp/x) %s \\n',
        "done",
    ]


def test_a_line_that_is_noted_again_is_there_once(home: Path) -> None:
    """A step is run again when the connection was lost, and nobody knows whether it had ended."""
    step = compose_steps.note(RECORD, when="2026-11-23T12:00:00Z", outcome="done")
    assert [do(step, home).returncode for _ in range(2)] == [0, 0]
    assert (
        home / ".fleet/history"
    ).read_text() == "2026-11-23T12:00:00Z\tship\t3f2a9c1b5d0e\ttim@desktop\tdone\n"
