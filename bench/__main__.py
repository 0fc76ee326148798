"""``make bench``: measure what must be fast, print it, and write ``docs/benchmarks.md``. Needs Docker; under 10 minutes.

``make bench-transfer`` is ``python -m bench transfer``: images over an emulated Wi-Fi, written to
``docs/benchmarks-transfer.md`` and its picture. Needs root as well; under 40 minutes. ``make bench-change`` is
``python -m bench change``: one changed line of a node until robots run it, written to ``docs/benchmarks-change.md``.

``docs/benchmarks-transfer.md`` and its picture. Needs root as well; under 40 minutes.

``make bench-build`` is ``python -m bench build``: a C++ package for a robot, cross-compiled and emulated, written to
``docs/benchmarks-build.md``. Under an hour on a computer that does nothing else, nearly all of it emulation.
"""

from __future__ import annotations

import os
import platform
import re
import signal
import sys
import tempfile
from contextlib import contextmanager
from datetime import UTC, datetime
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
    from collections.abc import Iterator, Mapping

TIME = 540
"""Seconds after which the measuring ends, finished or not; cleaning up comes after that."""

TRANSFER_TIME = 2400
"""The same for ``make bench-transfer``."""

CHANGE_TIME = 2400
"""The same for ``make bench-change``."""

BUILD_TIME = 7200
"""The same for ``make bench-build``."""

ROBOTS = 3
FLEETS = (1, 20, 200)
SERVERS = 50
MEGABYTE = 10**6


def main() -> int:
    """Measure, print, write; 0 when every goal is met, 1 when one is not."""
    if sys.argv[1:2] == ["transfer"]:
        return _transfer(transfer.asked(sys.argv[2:]))
    if sys.argv[1:2] == ["change"]:
        return _change(change.asked(sys.argv[2:]))
    if sys.argv[1:2] == ["build"]:
        return _build()
    screen = Screen()
    when, load = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), os.getloadavg()[0]
    try:
        with tempfile.TemporaryDirectory(prefix="fleetbench") as folder, _bounded(TIME):
            environment = _environment()
            rows = [*_asking(Path(folder), environment, screen)]
            more, engine = _streaming(Path(folder), environment, screen)
    except (FleetError, RuntimeError, TimeoutError) as problem:
        screen.say(f"bench: {problem}")
        return 1
    rows = [*more, *rows]
    screen.table(report.COLUMNS, [[(cell, "") for cell in row.cells()] for row in rows])
    page = report.page(rows, when=when, machine=_machine(engine, load))
    (ROOT / "docs" / "benchmarks.md").write_text(page, encoding="utf-8")
    return 0 if all(row.met for row in rows) else 1


def _transfer(asked: transfer.Asked) -> int:
    screen = Screen()
    when, load = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), os.getloadavg()[0]
    try:
        with tempfile.TemporaryDirectory(prefix="fleetbench") as folder, _bounded(TRANSFER_TIME):
            measured = transfer.measure(
                asked, folder=Path(folder), environment=_environment(), say=screen.say
            )
    except (FleetError, RuntimeError, TimeoutError) as problem:
        screen.say(f"bench: {problem}")
        return 1
    rows = figures.goals(measured)
    screen.table(report.COLUMNS, [[(cell, "") for cell in row.cells()] for row in rows])
    page = figures.page(measured, when=when, machine=_machine(measured.engine, load))
    (ROOT / "docs" / "benchmarks-transfer.md").write_text(page, encoding="utf-8")
    (ROOT / "docs" / "benchmarks-transfer.svg").write_text(figures.picture(measured), encoding="utf-8")
    return 0 if all(row.met for row in rows) and not measured.failed else 1


def _change(asked: change.Asked) -> int:
    screen = Screen()
    when, load = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), os.getloadavg()[0]
    try:
        with tempfile.TemporaryDirectory(prefix="fleetbench") as folder, _bounded(CHANGE_TIME):
            measured = change.measure(asked, folder=Path(folder), environment=_environment(), say=screen.say)
    except (FleetError, RuntimeError, TimeoutError) as problem:
        screen.say(f"bench: {problem}")
        return 1
    rows = change_page.goals(measured)
    screen.table(report.COLUMNS, [[(cell, "") for cell in row.cells()] for row in rows])
    page = change_page.page(measured, when=when, machine=_machine(measured.engine, load))
    (ROOT / "docs" / "benchmarks-change.md").write_text(page, encoding="utf-8")
    return 0 if all(row.met for row in rows) and not measured.unfinished else 1


def _build() -> int:
    screen = Screen()
    when, load = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), os.getloadavg()[0]
    try:
        with tempfile.TemporaryDirectory(prefix="fleetbench") as folder, _bounded(BUILD_TIME):
            rows = compiling.measure(folder=Path(folder), say=screen.say)
    except (FleetError, RuntimeError, TimeoutError) as problem:
        screen.say(f"bench: {problem}")
        return 1
    screen.table(report.COLUMNS, [[(cell, "") for cell in row.cells()] for row in rows])
    page = compiling.page(rows, when=when, machine=_machine("", load))
    (ROOT / "docs" / "benchmarks-build.md").write_text(page, encoding="utf-8")
    return 0 if all(row.met for row in rows) else 1


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
