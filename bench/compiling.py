"""How long does a C++ package take for a robot: with the cross compiler, and with the same Dockerfile under emulation?"""

from __future__ import annotations

import shutil
import subprocess
import time
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING
from uuid import uuid4

from bench.pairs import Cost, Pairs
from bench.report import COLUMNS, Row, ratio, table
from fleet.images import debian_base
from fleet.images.docker_cli import buildkit_client, docker_or_none
from fleet.images.emulation import desktop_platform
from fleet.starter import example

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

PLATFORM = "linux/arm64"
WAYS = ("cross", "emulated")
GOAL = 0.2
NEW, EDITS = 1, 2
"""Rounds: with an empty cache, and after an edit."""
COMPILED = "packages"
"""The stage of the Dockerfile that compiles."""
BELOW = ("tools", "sysroot")
"""The stages that it needs: the compiler, and the development packages."""

_PAGE = """\
# Compiling for robots

Written by `make bench-build` on {when}; do not edit. {machine}

{table}

Both build `packages/listener`, a C++ node with roscpp, for {platform} from `docker/packages.Dockerfile`, in turn (A B A B
...). The figure is the median of the pairs' ratios: 0.20x is five times as fast. Times depend on the computer and on what
else it does, ratios much less.

- **Cross** is how `fab build` does it: the desktop's processor runs the compiler, against a sysroot with the robot's
  development packages. **Emulated** has the one more argument `COMPILE=emulated`: each program is the robot's, run by QEMU.
- **Compiling** is the stage `packages` of that Dockerfile, with an empty cache of compiled packages: CMake, the compiler,
  and the installation. The stages below it are built before that and not part of the ratio: they fetch and unpack the
  compiler and the development packages, once for all packages.
- **After an edit** of one line in `listener.cpp`, the same stage is built again, with the cache of the build before.
- **From nothing** is the whole image with `--no-cache`, cross only, so that this run has an end: fetching and unpacking the
  compiler, the development packages and the run-time packages, and compiling. Only Debian's base images are there.
"""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A copy of the project that may be edited, and caches of its own."""

    folder: Path
    run: str

    def build(self, way: str, *flags: str, cache: int = 0) -> Cost:
        """Build once. Raises ``RuntimeError`` with the last lines, if that fails."""
        bases = {"BUILD_BASE": desktop_platform(), "RUN_BASE": PLATFORM}
        arguments = {name: debian_base.ensure("bookworm", of, say=print) for name, of in bases.items()}
        arguments |= {"COMPILE": way, "CACHE": f"{self.run}-{way}-{cache}"}
        command = (*buildkit_client(), "build", "--platform", PLATFORM, "--tag", self.image(way), *flags)
        options = [part for name, value in arguments.items() for part in ("--build-arg", f"{name}={value}")]
        where = ("--file", str(self.folder / "docker/packages.Dockerfile"), str(self.folder))
        started = time.monotonic()
        done = subprocess.run((*command, *options, *where), capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"the build did not succeed: {(done.stdout + done.stderr)[-2000:]}")
        return Cost(seconds=time.monotonic() - started, cpu=0)

    def edit(self, number: int) -> None:
        """Change one line of the node."""
        source = self.folder / "packages/listener/src/listener.cpp"
        text = (example.files()["packages/listener/src/listener.cpp"]).read_text(encoding="utf-8")
        source.write_text(text.replace(" ms ago", f" ms ago ({number})"), encoding="utf-8")

    def image(self, way: str) -> str:
        """The name of the image that is built."""
        return f"fleetbench-listener:{way}"


def measure(*, folder: Path, say: Callable[[str], None]) -> tuple[Row, ...]:
    """Build both ways in turn, with an empty cache and after edits. Raises ``RuntimeError``, ``FleetError``."""
    for name, path in example.files().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, folder / name)
    bench = Bench(folder=folder, run=uuid4().hex[:8])
    try:
        return _measured(bench, say)
    finally:
        for way in WAYS:
            docker_or_none("image", "rm", "--force", bench.image(way))


def _measured(bench: Bench, say: Callable[[str], None]) -> tuple[Row, ...]:
    say("from nothing: cross")
    nothing = bench.build("cross", "--no-cache").seconds
    for way, stage in product(
        WAYS, BELOW
    ):  # what was built stays in Docker's cache, also if this run is ended
        say(f"not measured: the stage {stage}, {way}")
        bench.build(way, "--target", stage)

    def both(cache: int) -> tuple[Cost, Cost]:
        cross, emulated = (bench.build(way, "--target", COMPILED, cache=cache) for way in WAYS)
        say(f"cross {cross.seconds:.0f} s, emulated {emulated.seconds:.0f} s")
        return cross, emulated

    new = []
    for number in range(NEW):
        say(f"compiling: {number + 1} of {NEW}")
        new.append(both(number + 1))
    edited = []
    for number in range(EDITS):
        say(f"after an edit: {number + 1} of {EDITS}")
        bench.edit(number)
        edited.append(both(NEW))
    return (
        ratio("Compiling, cross beside emulated", _pairs(new), goal=GOAL),
        ratio("After an edit of one line, cross beside emulated", _pairs(edited), goal=GOAL),
        Row(what="From nothing, cross", value=nothing, goal=None, unit="s", how="one build"),
    )


def _pairs(rounds: Sequence[tuple[Cost, Cost]]) -> Pairs:
    return Pairs(fleet=tuple(cross for cross, _ in rounds), usual=tuple(other for _, other in rounds))


def page(rows: tuple[Row, ...], *, when: str, machine: str) -> str:
    """The page ``docs/benchmarks-build.md``."""
    cells = table(COLUMNS, [row.cells() for row in rows])
    return _PAGE.format(when=when, machine=machine, table=cells, platform=PLATFORM)
