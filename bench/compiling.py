"""How long does a C++ package take for a robot: with the cross compiler, and with the same Dockerfile under emulation?"""

from __future__ import annotations

import shutil
import subprocess
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING
from uuid import uuid4

from bench.pairs import Cost, Pairs
from bench.report import COLUMNS, Row, ratio, table
from fleet.images import debian_base
from fleet.images.docker_cli import buildkit_client, docker_or_none
from fleet.images.emulation import desktop_platform
from fleet.starter import example

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PLATFORM = "linux/arm64"
GOAL = 0.2
EDITS = 3
LONGEST = 3600.0
"""Seconds that one build may take: under emulation on a computer that does other things, too."""

_PAGE = """\
# Compiling for robots

Written by `make bench-build` on {when}; do not edit. {machine}

{table}

Both build `packages/listener`, a C++ node with roscpp, for {platform} from `docker/packages.Dockerfile`, in turn (A B A B
...). The figure is the median of the pairs' ratios: 0.20x is five times as fast. Times depend on the computer and on what
else it does, ratios much less.

- **Cross** is how `fab build` does it: the desktop's processor runs the compiler, against a sysroot with the robot's
  development packages. **Emulated** has the one more argument `COMPILE=emulated`: each program is the robot's, run by QEMU.
- **From nothing** is a build without any cache: the compiler, the development packages and the run-time packages are
  fetched and unpacked, too. Only Debian's base images are there.
- **After an edit** of one line in `listener.cpp`, the image is built again with the cache of the build before.
"""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A copy of the project that may be edited, and a cache of its own."""

    folder: Path
    run: str

    def build(self, way: str, *flags: str) -> Cost:
        """Build once. Raises ``RuntimeError`` with the last lines, if that fails."""
        bases = {"BUILD_BASE": desktop_platform(), "RUN_BASE": PLATFORM}
        arguments = {name: debian_base.ensure("bookworm", of, say=print) for name, of in bases.items()}
        arguments |= {"COMPILE": way, "CACHE": f"{self.run}-{way}"}
        command = (*buildkit_client(), "build", "--platform", PLATFORM, "--tag", self.image(way), *flags)
        options = [part for name, value in arguments.items() for part in ("--build-arg", f"{name}={value}")]
        where = ("--file", str(self.folder / "docker/packages.Dockerfile"), str(self.folder))
        started = time.monotonic()
        done = subprocess.run(
            (*command, *options, *where), capture_output=True, text=True, timeout=LONGEST, check=False
        )
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
    """Build both ways in turn, from nothing and after edits. Raises ``RuntimeError``, ``FleetError``."""
    for name, path in example.files().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, folder / name)
    bench = Bench(folder=folder, run=uuid4().hex[:8])
    try:
        say("from nothing: cross")
        cross = bench.build("cross", "--no-cache")
        say(f"from nothing: emulated (cross took {cross.seconds:.0f} s)")
        emulated = bench.build("emulated", "--no-cache")
        rounds = []
        for number in range(EDITS):
            say(f"after an edit: {number + 1} of {EDITS}")
            bench.edit(number)
            rounds.append((bench.build("cross"), bench.build("emulated")))
    finally:
        for way in ("cross", "emulated"):
            docker_or_none("image", "rm", "--force", bench.image(way))
    edits = Pairs(fleet=tuple(a for a, _ in rounds), usual=tuple(b for _, b in rounds))
    cold = Pairs(fleet=(cross,), usual=(emulated,))
    return (
        ratio("From nothing, cross beside emulated", cold, goal=GOAL),
        ratio("After an edit of one line, cross beside emulated", edits, goal=GOAL),
    )


def page(rows: tuple[Row, ...], *, when: str, machine: str) -> str:
    """The page ``docs/benchmarks-build.md``."""
    cells = table(COLUMNS, [row.cells() for row in rows])
    return _PAGE.format(when=when, machine=machine, table=cells, platform=PLATFORM)
