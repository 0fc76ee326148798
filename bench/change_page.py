"""How do the runs of a changed line read: as goals met or not, and as a page of the documentation?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.change import BALLAST, PHASES, WAYS
from bench.report import COLUMNS, Row, table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bench.change import Measured, Timeline

NAMES = {
    "limit": "the limit: stop and start by hand",
    "fab": "`fab ship`",
    "save": "`docker save \\| ssh docker load`, `compose up -d`",
    "registry": "push, pull through `ssh -R`, `compose up -d --wait`",
}

BEYOND = 2.0
"""Seconds that `fab ship` may take beyond the limit."""

_PAGE = """\
# From one changed line to robots that run it

Written by `make bench-change` on {when}; do not edit. {machine}

{goals}

Seconds of each part, on the robot whose first message came last:

{runs}
{unfinished}
- **A run** changes one line of the node, builds the image, brings it to the robots and starts it. Each way begins with its
  own previous version running, on the same robots. Ways are measured in turn; with one robot {rounds} times, and the
  table shows the run that took the median time.
- **The limit** is what no way can avoid: on each robot `docker compose up -d --force-recreate` by hand, with nothing to
  bring, from the signal to stop until the first message. With many robots they stop and start all at once, on
  the processors of this computer.
- **The parts.** begin: the program starts, reads the inventory and asks Compose; probe: it connects and looks at the
  robots; out of Docker: the new layer leaves this computer's Docker and is packed; bytes: files and layers
  travel; load: the robot's Docker takes them, and they are proved; stop, start, first message: of the container;
  done: until the command ends. A cell is empty where a way cannot tell parts apart; the next cell has both.
- **All** is without the build: from its end until the command has ended, and the last robot has sent a message. The second
  way does not check that anything runs, and the third waits for the health check of the engine.
- **The image** is the talker, {small} MB; the large one has {ballast} MB more below the layer of the code.
- **Robots** are virtual Pis on this computer, for its own platform: the link is as fast as it gets, which favours the
  ways that send more.
"""


def goals(measured: Measured) -> tuple[Row, ...]:
    """What `fab ship` is held against."""
    return tuple(_goals(measured))


def _goals(measured: Measured) -> Iterator[Row]:
    for scene in measured.scenes:
        fab, limit = (measured.median(scene, way) for way in ("fab", "limit"))
        if not (fab and limit):
            continue
        how = f"{fab.shipped:.1f} s, and the limit is {limit.least:.1f} s"
        yield Row(
            what=f"{scene.title}: beyond the limit",
            value=measured.beyond(scene),
            goal=BEYOND,
            unit="s",
            how=how,
        )
        least = {"save": 5.0 if scene.stack == "large" else 3.0, "registry": 1.0}
        for way, times in least.items():
            usual = measured.median(scene, way)
            if usual:
                how = f"{fab.shipped:.1f} s and {usual.shipped:.1f} s"
                what = f"{scene.title}: beside {NAMES[way]}"
                yield Row(what=what, value=1 / measured.ratio(scene, way), goal=1 / times, unit="x", how=how)


def page(measured: Measured, *, when: str, machine: str) -> str:
    """The page ``docs/benchmarks-change.md``."""
    return _PAGE.format(
        when=when,
        machine=machine,
        goals=table(COLUMNS, [row.cells() for row in goals(measured)]),
        runs=table(("what", "way", *PHASES, "all"), rows(measured)),
        unfinished=f"\nThis run ended early, {measured.unfinished}.\n" if measured.unfinished else "",
        rounds=max(len(runs) for runs in measured.runs.values()),
        small=round(measured.sizes["small"] / 1e6),
        ballast=round(BALLAST / 1e6),
    )


def rows(measured: Measured) -> list[tuple[str, ...]]:
    """The time lines as cells."""
    there = (
        (scene, way, run)
        for scene in measured.scenes
        for way in ("limit", *WAYS)
        if (run := measured.median(scene, way))
    )
    return [(scene.title, NAMES[way], *_cells(run, limit=way == "limit")) for scene, way, run in there]


def _cells(run: Timeline, *, limit: bool) -> Iterator[str]:
    parts = run.parts
    shown = PHASES[PHASES.index("stop") : -1] if limit else PHASES
    for phase in PHASES:
        yield f"{parts[phase]:.1f}" if phase in parts and phase in shown else ""
    yield f"{run.least if limit else run.shipped:.1f}"
