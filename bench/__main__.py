"""``make bench``: measure what must be fast, print it, and write ``docs/benchmarks.md``. Needs Docker; under 10 minutes.

``make bench-transfer`` is ``python -m bench transfer``: images over an emulated Wi-Fi, written to
``docs/benchmarks-transfer.md`` and its picture. Needs root as well; under 40 minutes. ``make bench-change`` is
``python -m bench change``: one changed line of a node until robots run it, written to ``docs/benchmarks-change.md``.
``make bench-build`` is ``python -m bench build``: a C++ package for a robot, cross-compiled and emulated, written to
``docs/benchmarks-build.md``. Under 25 minutes, nearly all of it emulation.
"""

from __future__ import annotations

import os
import platform
import re
import signal
import sys
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import paramiko

from bench import asking, change, change_page, compiling, figures, report, resolving, streaming, transfer
from bench.pairs import ROOT, cpu_per_gigabyte, seconds, spend
from bench.report import Row, ratio
from fleet.cli.console import Screen
from fleet.errors import FleetError
from fleet.images.docker_cli import docker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

TIME = 540
"""Seconds after which the measuring ends, finished or not; cleaning up comes after that."""

TRANSFER_TIME = 2400
"""The same for ``make bench-transfer``."""

CHANGE_TIME = 2400
"""The same for ``make bench-change``."""

BUILD_TIME = 1500
"""The same for ``make bench-build``. What it has built by then stays in Docker's cache, and a second run begins there."""

ROBOTS = 3
FLEETS = (1, 20, 200)
SERVERS = 50
MEGABYTE = 10**6


@dataclass(frozen=True, kw_only=True)
class Result:
    """What was measured. ``pages`` has the files in docs/, for a time and a computer; ``whole``: nothing of it failed."""

    rows: Sequence[Row]
    engine: str
    pages: Callable[[str, str], Mapping[str, str]]
    whole: bool = True


def main() -> int:
    """Measure, print, write; 0 when every goal is met, 1 when one is not."""
    which, words = sys.argv[1:2], sys.argv[2:]
    if which == ["transfer"]:
        return _run(partial(_transfer, transfer.asked(words)), limit=TRANSFER_TIME)
    if which == ["change"]:
        return _run(partial(_change, change.asked(words)), limit=CHANGE_TIME)
    if which == ["build"]:
        return _run(_build, limit=BUILD_TIME)
    return _run(_local, limit=TIME)


def _run(measure: Callable[[Path, Screen], Result], *, limit: int) -> int:
    screen = Screen()
    when, load = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), os.getloadavg()[0]
    try:
        with tempfile.TemporaryDirectory(prefix="fleetbench") as folder, _bounded(limit):
            result = measure(Path(folder), screen)
    except (FleetError, RuntimeError, TimeoutError) as problem:
        screen.say(f"bench: {problem}")
        return 1
    screen.table(report.COLUMNS, [[(cell, "") for cell in row.cells()] for row in result.rows])
    for name, text in result.pages(when, _machine(result.engine, load)).items():
        (ROOT / "docs" / name).write_text(text, encoding="utf-8")
    return 0 if result.whole and all(row.met for row in result.rows) else 1


def _local(folder: Path, screen: Screen) -> Result:
    environment = _environment()
    asked = _asking(folder, environment, screen)
    streamed, engine = _streaming(folder, environment, screen)
    rows = [*streamed, *asked]
    return Result(
        rows=rows,
        engine=engine,
        pages=lambda when, machine: {"benchmarks.md": report.page(rows, when=when, machine=machine)},
    )


def _transfer(asked: transfer.Asked, folder: Path, screen: Screen) -> Result:
    measured = transfer.measure(asked, folder=folder, environment=_environment(), say=screen.say)
    return Result(
        rows=figures.goals(measured),
        engine=measured.engine,
        pages=lambda when, machine: {
            "benchmarks-transfer.md": figures.page(measured, when=when, machine=machine),
            "benchmarks-transfer.svg": figures.picture(measured),
        },
        whole=not measured.failed,
    )


def _change(asked: change.Asked, folder: Path, screen: Screen) -> Result:
    measured = change.measure(asked, folder=folder, environment=_environment(), say=screen.say)
    return Result(
        rows=change_page.goals(measured),
        engine=measured.engine,
        pages=lambda when, machine: {
            "benchmarks-change.md": change_page.page(measured, when=when, machine=machine)
        },
        whole=not measured.unfinished,
    )


def _build(folder: Path, screen: Screen) -> Result:
    rows = compiling.measure(folder=folder, say=screen.say)
    return Result(
        rows=rows,
        engine="",
        pages=lambda when, machine: {"benchmarks-build.md": compiling.page(rows, when=when, machine=machine)},
    )


def _asking(folder: Path, environment: Mapping[str, str], screen: Screen) -> tuple[Row, ...]:
    screen.say("fab --list")
    lists = asking.listing(environment=environment, rounds=7)
    with asking.servers(SERVERS, folder=folder, environment=environment) as servers:
        screen.say(f"fab status over {SERVERS} SSH servers")
        asked = servers.compare(rounds=7, within=60)
    cpu = sorted(run.cpu for run in lists)[len(lists) // 2]
    how = f"median of {len(lists)}; {cpu:.2f} s of CPU"
    screen.say(f"fab build --dry for {', '.join(map(str, FLEETS))} robots")
    resolved = resolving.rows(FLEETS, folder=folder, environment=environment, rounds=3)
    return (
        *resolved,
        ratio(f"`fab status`, {SERVERS} SSH servers, beside a bare Paramiko pool", asked, goal=1.5),
        Row(what="`fab --list`", value=seconds(lists), goal=0.7, unit="s", how=how),
    )


def _streaming(folder: Path, environment: Mapping[str, str], screen: Screen) -> tuple[tuple[Row, ...], str]:
    """The rows, and the version of Docker on the robots."""
    with streaming.robots(ROBOTS, folder=folder, environment=environment, say=screen.say) as robots:
        screen.say("streaming into docker load: one robot")
        one = robots.compare(streaming.LOAD, count=1, rounds=7, within=90)
        screen.say(f"streaming into docker load: {ROBOTS} robots at once")
        many = robots.compare(streaming.LOAD, count=ROBOTS, rounds=5, within=120)
        screen.say("streaming into nothing: one robot")
        wire = robots.compare(streaming.SINK, count=1, rounds=5, within=30)
        engine = robots.engine()
    size = f"{wire.fleet[0].sent / MEGABYTE:.0f} MB"
    peak = max(run.peak for run in many.fleet) / MEGABYTE
    openssh = sum(run.cpu for run in wire.usual) / sum(run.sent for run in wire.fleet) * 1e9
    rows = (
        ratio(f"An image of {size} into `docker load`, 1 robot, beside OpenSSH", one, goal=1.1),
        ratio(f"The same, {ROBOTS} robots at once", many, goal=1.1),
        Row(what=f"Memory, {ROBOTS} robots at once", value=peak, goal=200, unit="MB", how="peak of all runs"),
        ratio("The same image into `cat > /dev/null`, 1 robot", wire, goal=None),
        Row(
            what="CPU per gigabyte sent",
            value=cpu_per_gigabyte(wire.fleet),
            goal=None,
            unit="s",
            how=f"OpenSSH: {openssh:.2f} s",
        ),
    )
    return rows, engine


def _environment() -> Mapping[str, str]:
    """What every measured process gets: it may keep its bytecode, as usual, and knows no inventory of the person's."""
    unwanted = ("PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX", "FLEET_INVENTORY")
    kept = {name: value for name, value in os.environ.items() if name not in unwanted}
    return {**kept, "PYTHONPATH": str(ROOT)}


def _machine(engine: str, load: float) -> str:
    processor = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    name = f" ({processor[1].strip()})" if processor else ""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    ours = docker("version", "--format", "{{.Server.Version}}")
    ssh = spend(("sh", "-c", "ssh -V 2>&1"), environment=os.environ)[1].partition(",")[0]
    return (
        f"The computer: {os.cpu_count()} cores{name}, {platform.machine()}, {memory:.0f} GB, load {load:.1f} at the start; "
        f"Docker {ours}{f', on the robots {engine}' if engine else ''}; {ssh}; Python {platform.python_version()}, Paramiko {paramiko.__version__}."
    )


@contextmanager
def _bounded(limit: int) -> Iterator[None]:
    """End what runs within with ``TimeoutError`` after so many seconds, and when asked to end; cleaning up still follows."""

    def end(number: int, _: object) -> NoReturn:
        why = f"not done after {limit} s; is this computer busy?" if number == signal.SIGALRM else "ended"
        raise TimeoutError(why)

    before = {number: signal.signal(number, end) for number in (signal.SIGALRM, signal.SIGTERM)}
    signal.alarm(limit)
    try:
        yield
    finally:
        signal.alarm(0)
        for number, handler in before.items():
            signal.signal(number, handler)


if __name__ == "__main__":
    sys.exit(main())
