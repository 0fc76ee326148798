from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fleet.robot.history import Event, history


@given(st.lists(st.text(), min_size=5, max_size=5))
def test_any_event_comes_back(words: list[str]) -> None:
    """White space apart, what was noted is what is read, from one line of the file."""
    when, verb, of, by, outcome = (" ".join(word.split()) for word in words)
    event = Event(when=words[0], verb=words[1], release=words[2], by=words[3], outcome=words[4])
    assert history(tuple(str(event).splitlines())) in (
        (Event(when=when, verb=verb, release=of, by=by, outcome=outcome),),
        (),  # nothing but white space
    )


@given(st.lists(st.text()))
def test_lines_that_are_no_events_are_passed_over(garbage: list[str]) -> None:
    """A history that a full disk cut, or a person edited, is still read."""
    good = "2026-11-23T12:00:00Z\tship\tabc\ttim@desktop\tdone"
    read = history((*(line for line in garbage if line.count("\t") != 4), good))
    assert read == (
        Event(when="2026-11-23T12:00:00Z", verb="ship", release="abc", by="tim@desktop", outcome="done"),
    )
