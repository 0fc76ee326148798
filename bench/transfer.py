"""What does it take to get an image to a robot over Wi-Fi: with `fab ship`, and the ways people know?

Each way has a virtual Pi and a link of its own, and they are measured side by side: the links are what is slow.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bench import images, layers, ways
from bench.pairs import ROOT, spend
from fleet.images.docker_cli import docker
from fleet.images.emulation import desktop_platform
from fleet.lab import lifecycle
from tests.support.sshd import free_port
from tests.support.wifi import Quality, joined, why_not

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from bench.layers import Layer
    from bench.ways import Lane, Run

NAME = "fleetbench-wifi"
QUALITY = Quality(rate=20, round_trip=(5, 20), loss=0.01)
CUT = "v1cut"
OUTAGE = 60.0
LIMIT = 1500.0  # seconds for one run

PLAN = {
    # Last, because it needs to know how much a run without an outage sends.
    "fab": (*images.VARIANTS, CUT),
    # Whatever has changed, these send the same bytes again.
    "save": ("v1",),
    "gzip": ("v1",),
    "rsync": ("v1", "v2code", "v2apt", "v2pip"),
    "pull": ("v1", "v2code", "v2apt"),
    "registry": ("v1", "v2code", "v2apt"),
}
"""Which variants each way is measured with."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the person wants measured."""

    ways: tuple[str, ...]
    variants: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """All runs that ended well, why the others did not, the layers of what was sent, and Docker's version on the robots."""

    runs: tuple[Run, ...]
    failed: Mapping[tuple[str, str], str]
    layers: Mapping[str, tuple[Layer, ...]]
    engine: str

    def run(self, way: str, variant: str) -> Run | None:
        """The run of a way with a variant, if there was one."""
        return next((run for run in self.runs if (run.way, run.variant) == (way, variant)), None)


def asked(arguments: Sequence[str]) -> Asked:
    """The options of `make bench-transfer`; everything, where there are none."""
    parser = argparse.ArgumentParser(prog="python -m bench transfer")
    parser.add_argument("--ways", nargs="+", choices=PLAN, default=tuple(PLAN))
    parser.add_argument("--variants", nargs="+", choices=PLAN["fab"], default=PLAN["fab"])
    chosen = parser.parse_args(arguments)
    return Asked(ways=tuple(chosen.ways), variants=tuple(chosen.variants))


def measure(
    wanted: Asked, *, folder: Path, environment: Mapping[str, str], say: Callable[[str], None]
) -> Measured:
    """Measure. Raises ``RuntimeError`` with what this computer lacks for it."""
    _check()
    images.ensure(say=say)
    say("measuring the layers")
    sizes = layers.measured([f"{images.NAME}:{variant}" for variant in ("v1", "v2code")])
    runs: list[Run] = []
    failed: dict[tuple[str, str], str] = {}
    with _lanes(wanted.ways, folder=folder, environment=environment, say=say) as lanes:

        def work(way: str) -> None:
            for variant in (variant for variant in PLAN[way] if variant in wanted.variants):
                try:
                    run = _run(lanes[way], way, variant, runs)
                except RuntimeError as problem:
                    failed[way, variant] = str(problem)
                    say(f"{way} {variant}: {problem}")
                else:
                    runs.append(run)
                    say(f"{way} {variant}: {run.payload / 1e6:.2f} MB in {run.seconds:.0f} s")

        pool = ThreadPoolExecutor(len(lanes))
        try:
            list(pool.map(work, lanes))
        finally:
            for lane in lanes.values():
                lane.over.set()
            pool.shutdown(cancel_futures=True)
        engine = docker(
            "exec", lanes[wanted.ways[0]].pi.container, "docker", "version", "--format", "{{.Server.Version}}"
        )
    return Measured(runs=tuple(runs), failed=failed, layers=sizes, engine=engine)


def _run(lane: Lane, way: str, variant: str, runs: Sequence[Run]) -> Run:
    if variant != CUT:
        lane.prepare(way, first=variant == "v1")
        return lane.measure(way, variant, limit=LIMIT)
    whole = next((run for run in runs if (run.way, run.variant) == (way, "v1")), None)
    if whole is None:
        raise RuntimeError("a cut run needs one that was not cut: v1")
    lane.prepare(way, first=True)
    cut = lane.measure(way, "v1", limit=LIMIT, outage=(whole.payload // 2, OUTAGE))
    return ways.renamed(cut, CUT)


def _check() -> None:
    missing = [tool for tool in ("zstd", "rsync", "gzip", "ssh") if shutil.which(tool) is None]
    if reason := why_not() or (missing and f"this needs {' and '.join(missing)}: install with apt-get"):
        raise RuntimeError(str(reason))


@contextlib.contextmanager
def _lanes(
    names: Sequence[str], *, folder: Path, environment: Mapping[str, str], say: Callable[[str], None]
) -> Iterator[Mapping[str, Lane]]:
    """A virtual Pi with Docker for each way, on the air; all removed afterwards."""
    directory = folder / "lab"
    lifecycle.down(directory=directory, name=NAME, say=lambda _: None)  # what a killed run left
    try:
        lifecycle.up(len(names), directory=directory, name=NAME, say=say)
        fleet = {"stack": str(ROOT / "docker/compose.yaml"), "include": [{"path": "lab/inventory.yaml"}]}
        (folder / "inventory.yaml").write_text(json.dumps(fleet), encoding="utf-8")
        for verb in (("trust", "--yes"), ("provision",)):
            say(f"fab {verb[0]}")
            fab = (ways.FAB, *verb, "--inventory", str(folder / "inventory.yaml"))
            spend(fab, environment=environment, limit=600)
        yield from _on_the_air(names, folder=folder, environment=environment, say=say)
    finally:
        lifecycle.down(directory=directory, name=NAME, say=say)


def _on_the_air(
    names: Sequence[str], *, folder: Path, environment: Mapping[str, str], say: Callable[[str], None]
) -> Iterator[Mapping[str, Lane]]:
    pis, port = lifecycle.list_(name=NAME), free_port()
    robots = {pi.name: int(docker("inspect", "--format", "{{.State.Pid}}", pi.container)) for pi in pis}
    with joined(robots, quality=QUALITY) as link:
        lanes = {}
        for name, pi in zip(names, pis, strict=True):
            quick = ways.Road(
                address=pi.address,
                inventory=_inventory(folder, pi.name, pi.address, "quick", pulls=name == "pull"),
            )
            address = link.addresses[pi.name]
            air = ways.Road(
                address=address,
                inventory=_inventory(folder, pi.name, address, "air", pulls=name == "pull"),
                inside=link.at_desk(),
            )
            trust = (ways.FAB, "trust", "--yes", "--inventory", str(air.inventory))
            spend(link.at_desk(*trust), environment=environment, limit=120)
            lanes[name] = ways.Lane(
                pi=pi,
                link=link,
                air=air,
                quick=quick,
                folder=folder,
                registry=port,
                environment=environment,
                over=threading.Event(),
            )
        with ways.registries(link, port=port, folder=folder, say=say):
            yield lanes


def _inventory(folder: Path, name: str, address: str, road: str, *, pulls: bool) -> Path:
    """One robot as `fab` knows it on one road. The robot runs this computer's own platform, which the images are for."""
    whole = {
        "stack": "compose.yaml",
        "known_hosts": str(folder / "lab" / "known_hosts"),
        "defaults": {
            "user": "pi",
            "identity_file": str(folder / "lab" / "id_ed25519"),
            "platform": desktop_platform(),
            "transport": "registry" if pulls else "ssh",
        },
        "robots": {name: {"address": address}},
    }
    path = folder / name / f"{road}.yaml"
    path.parent.mkdir(exist_ok=True)
    path.with_name("compose.yaml").write_text("services: {app: {image: none}}\n", encoding="utf-8")
    path.write_text(json.dumps(whole), encoding="utf-8")
    return path
