"""How runs over Wi-Fi are told: the goals, the page and the picture, from values."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest

from bench import figures, transfer
from bench.layers import Layer
from bench.transfer import CUT, Measured
from bench.ways import Run


def run(way: str, variant: str, *, payload: int, speed: float = 2e6, written: int = 0) -> Run:
    return Run(
        way=way,
        variant=variant,
        seconds=100,
        wire=payload + 1_000_000,
        payload=payload,
        written=written,
        robot_memory=50_000_000,
        desk_memory=60_000_000,
        speed=speed,
    )


def measured(*runs: Run) -> Measured:
    base, code = Layer(size=700_000_000, compressed=290_000_000), Layer(size=2_000_000, compressed=500_000)
    layers = {f"fleetbench-app:{name}": (base, code) for name in ("v1", "v2code")}
    return Measured(runs=runs, failed={("rsync", "v2apt"): "no rsync there"}, layers=layers, engine="26")


FIRST = run("fab", "v1", payload=300_000_000)
CODE = run("fab", "v2code", payload=533_000, written=5_000_000)
USUAL = run("save", "v1", payload=710_000_000, speed=0.8e6)


def test_goals_are_told_of_what_was_measured() -> None:
    """A first ship is held against all layers, and OpenSSH's speed against that of the same ship."""
    rows = figures.goals(measured(FIRST, CODE, USUAL))
    assert [(row.cells()[1], row.cells()[3]) for row in rows] == [
        ("1.03x", "yes"),
        ("0.40x", "yes"),
        ("533.00 kB", "NO"),
        ("2.50x", "yes"),
    ]
    assert figures.goals(measured()) == ()


@pytest.mark.parametrize(("payload", "verdict"), [(532_000, "yes"), (533_000, "NO")])
def test_a_code_change_may_cost_its_layer_and_32_kb(payload: int, verdict: str) -> None:
    """Whatever the layer compresses to."""
    row = figures.goals(measured(run("fab", "v2code", payload=payload)))[0]
    assert row.cells()[3] == verdict


def test_an_outage_is_told_beside_the_run_without() -> None:
    """How much was sent again is the figure."""
    rows = figures.goals(measured(FIRST, run("fab", CUT, payload=330_000_000)))
    assert [row.cells()[1] for row in rows if "outage" in row.what] == ["1.10x"]


def test_the_page_has_every_run_and_what_failed() -> None:
    """In the order of what was shipped, then of the ways."""
    page = figures.page(measured(USUAL, CODE, FIRST), when="2026-01-02 03:04 UTC", machine="The computer.")
    rows = [line for line in page.splitlines() if " MB | 100 s | " in line]
    assert [row.split(" | ")[1] for row in rows] == [
        "the first ship",
        "the first ship",
        "one line of code changed",
    ]
    assert rows[0].startswith("| `fab ship` | the first ship | 301.00 MB | 100 s | 16.0 Mbit/s | 0 MB |")
    assert (
        "- `docker save`, `rsync -z`, `docker load`, one more apt package: not measured, no rsync there"
        in page
    )


def test_the_picture_is_a_picture() -> None:
    """One bar for each run, the longest for the most bytes."""
    picture = ET.fromstring(figures.picture(measured(FIRST, CODE, USUAL)))  # noqa: S314  our own
    bars = [float(bar.get("width", "")) for bar in picture.iter("{http://www.w3.org/2000/svg}rect")]
    assert len(bars) == 3
    assert bars[1] == max(bars) > bars[0] > bars[2]
    assert figures.picture(measured())


def test_ways_and_variants_can_be_chosen() -> None:
    """Everything, where none is named."""
    assert transfer.asked([]).ways == tuple(transfer.PLAN)
    chosen = transfer.asked(["--ways", "fab", "save", "--variants", "v2code"])
    assert (chosen.ways, chosen.variants) == (("fab", "save"), ("v2code",))
