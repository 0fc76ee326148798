from __future__ import annotations

from fleet.plan.step import Bytes, ImageArchive, Plan, Record, Step

RECORD = Record(verb="ship", release="3f2a9c1b5d0e", by="tim@desktop")


def test_a_plan_knows_how_much_it_sends() -> None:
    """The bytes of all feeds count, those of commands without one do not."""
    feeds = (Bytes(label="files", data=b"12345"), None, ImageArchive(image="a", reference="a", size=1000))
    steps = tuple(Step(title="", argv=("true",), feed=feed) for feed in feeds)
    assert Plan(robot="pi1", summary="", steps=steps).size == 1005
