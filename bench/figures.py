"""How do the runs over Wi-Fi read: as goals met or not, as a page of the documentation, and as a picture?"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from bench.images import NAME, VARIANTS
from bench.report import COLUMNS, Row, table
from bench.transfer import CUT, OUTAGE, QUALITY
from bench.ways import WAYS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bench.transfer import Measured
    from bench.ways import Run

RUN_COLUMNS = (
    "way",
    "what",
    "on the air",
    "time",
    "while sending",
    "written",
    "robot's memory",
    "desk's memory",
)

_PAGE = """\
# How images reach robots over Wi-Fi

Written by `make bench-transfer` on {when}; do not edit. {machine}

![Bytes and time of each way](benchmarks-transfer.svg)

{goals}

{runs}
{failed}
- **The link** is emulated: {rate:g} Mbit/s each way, {least:g} to {most:g} ms there and back, {loss:g} % of packets lost, on
  both ends TCP's cubic unless a program chooses otherwise. Each way has a virtual Pi and a link of its own; they are
  measured side by side.
- **The image** is a Debian with an apt layer, a pip layer, a model and code, for the desktop's own platform:
  {layers}. {changed}
- **On the air** is every byte in every packet, both ways, headers and lost packets too. The goals count payload: what TCP
  delivered to the robot, SSH's and `fab`'s own talk included.
- **Time** is from the start of the line to its end, with all of it: saving, compressing, sending, unpacking, and for
  `fab ship` starting the container as well. **While sending** is payload over the time in which it flowed.
- **Written** is what the robot's processes handed to its disk. The robot's **memory** is what the way took above what was
  in use before, the desk's is that of all its processes together; this computer's own Docker Engine is in neither.
- **Before each run** the robot is wiped; for everything but the first ship, the same way brings `v1` first, over a cable.
  `docker save | ssh docker load` sends the same bytes whatever has changed, so it is measured once, as is the one with gzip.
- **The pip layer built again** changes the code layer above it as well, by a date. That one is sent whole, and is nearly all
  of this run's payload: its patch would be smaller, and there later, because a robot needs seconds for making a layer.
- **Time of small changes** is `docker save` for the most part: a classic store stages the whole image before it gives out
  one layer.
- **{cut}**: half-way through, nothing gets through for {outage:g} s; the same line is typed again until it succeeds.
- `zstd` is `zstd -3 --long=27` of each layer by itself.
"""

_WIDTH, _LEFT, _RIGHT, _LINE = 900, 300, 190, 24


def names() -> dict[str, str]:
    """What each variant is called for people."""
    return {**VARIANTS, CUT: f"the first ship, with an outage of {OUTAGE:g} s"}


def goals(measured: Measured) -> tuple[Row, ...]:
    """What `fab ship` is held against; only what was measured."""
    return tuple(_goals(measured))


def _goals(measured: Measured) -> Iterator[Row]:
    layers = {name.partition(":")[2]: found for name, found in measured.layers.items()}
    if first := measured.run("fab", "v1"):
        small = sum(layer.compressed for layer in layers["v1"])
        how = f"{first.payload / 1e6:.1f} MB and {small / 1e6:.1f} MB"
        yield _row("First ship: payload beside `zstd` of the layers", first.payload / small, 1.05, "x", how)
        if usual := measured.run("save", "v1"):
            how = f"{usual.speed * 8e-6:.1f} and {first.speed * 8e-6:.1f} Mbit/s"
            what = "Speed while sending: OpenSSH with cubic, beside `fab ship`"
            yield _row(what, usual.speed / first.speed, 0.5, "x", how)
        if cut := measured.run("fab", CUT):
            how = f"{cut.payload / 1e6:.1f} MB, {cut.seconds:.0f} s, {cut.tries} times typed"
            yield _row(
                "First ship with an outage: payload beside the uncut run",
                cut.payload / first.payload,
                None,
                "x",
                how,
            )
    if code := measured.run("fab", "v2code"):
        layer = layers["v2code"][-1]
        goal = (layer.compressed + 32_000) / 1e3
        how = f"the layer: {layer.size / 1e3:.0f} kB, {layer.compressed / 1e3:.0f} kB with `zstd`"
        yield _row("Code changed: payload", code.payload / 1e3, goal, "kB", how)
        yield _row(
            "Code changed: written on the robot beside the layer", code.written / layer.size, 3, "x", how
        )
    most: dict[str, float | None] = {"v2apt": 2.0, "v2pip": 0.1, "v2sec": None}
    for variant, limit in most.items():
        if run := measured.run("fab", variant):
            what = f"{VARIANTS[variant].capitalize()}: payload"
            yield _row(what, run.payload / 1e6, limit, "MB", f"{run.seconds:.0f} s")


def _row(what: str, value: float, goal: float | None, unit: str, how: str) -> Row:
    return Row(what=what, value=value, goal=goal, unit=unit, how=how)


def page(measured: Measured, *, when: str, machine: str) -> str:
    """The page ``docs/benchmarks-transfer.md``."""
    failed = [
        f"- {WAYS[way]}, {names()[what]}: not measured, {reason}"
        for (way, what), reason in measured.failed.items()
    ]
    first = measured.layers[f"{NAME}:v1"]
    return _PAGE.format(
        when=when,
        machine=machine,
        goals=table(COLUMNS, [row.cells() for row in goals(measured)]),
        runs=table(RUN_COLUMNS, [_cells(run) for run in _sorted(measured)]),
        failed="".join(f"{line}\n" for line in failed),
        rate=QUALITY.rate,
        least=QUALITY.round_trip[0],
        most=QUALITY.round_trip[1],
        loss=QUALITY.loss * 100,
        layers=" + ".join(f"{layer.size / 1e6:.0f}" for layer in first) + " MB",
        changed=" ".join(f"`{name}` is {what}." for name, what in VARIANTS.items()),
        cut=names()[CUT].capitalize(),
        outage=OUTAGE,
    )


def _sorted(measured: Measured) -> list[Run]:
    ways, variants = tuple(WAYS), tuple(names())
    return sorted(measured.runs, key=lambda run: (variants.index(run.variant), ways.index(run.way)))


def _cells(run: Run) -> tuple[str, ...]:
    return (
        WAYS[run.way],
        names()[run.variant],
        f"{run.wire / 1e6:.2f} MB",
        f"{run.seconds:.0f} s",
        f"{run.speed * 8e-6:.1f} Mbit/s",
        *(f"{size / 1e6:.0f} MB" for size in (run.written, run.robot_memory, run.desk_memory)),
    )


def picture(measured: Measured) -> str:
    """The picture ``docs/benchmarks-transfer.svg``: a bar for each run, as long as its bytes on the air."""
    runs = _sorted(measured)
    most = max((run.wire for run in runs), default=1)
    parts, y, variant = [], 8, ""
    for run in runs:
        if run.variant != variant:
            variant = run.variant
            y += _LINE
            parts.append(f'<text x="0" y="{y}" class="head">{escape(names()[variant].capitalize())}</text>')
        y += _LINE
        length = max(1.0, (_WIDTH - _LEFT - _RIGHT) * run.wire / most)
        words = WAYS[run.way].replace("`", "").replace("\\", "")
        said = f"{run.wire / 1e6:.{0 if run.wire > 1e7 else 2}f} MB, {run.seconds:.0f} s"
        ours = ' class="ours"' if run.way == "fab" else ""
        parts += [
            f'<text x="{_LEFT - 8}" y="{y}" text-anchor="end">{escape(words)}</text>',
            f'<rect x="{_LEFT}" y="{y - 13}" width="{length:.1f}" height="16"{ours}/>',
            f'<text x="{_LEFT + length + 8:.1f}" y="{y}">{said}</text>',
        ]
    style = (
        "text{font:13px sans-serif;fill:#222}.head{font-weight:bold}rect{fill:#9aa5b1}.ours{fill:#0b7285}"
        "@media(prefers-color-scheme:dark){text{fill:#ddd}}"
    )
    size = f'width="{_WIDTH}" height="{y + 12}" viewBox="0 0 {_WIDTH} {y + 12}"'
    lines = (f'<svg xmlns="http://www.w3.org/2000/svg" {size}>', f"<style>{style}</style>", *parts, "</svg>")
    return "\n".join(lines) + "\n"
