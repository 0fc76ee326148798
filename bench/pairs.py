"""What does a way of doing something cost, and how do two ways compare?

Two ways are measured in turn (A B A B ...) and compared pair by pair: whatever else the computer does meanwhile slows
both, and the median of the ratios is far steadier than the times themselves.
"""

from __future__ import annotations

import os
import resource
import signal
import statistics
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

ROOT = Path(__file__).resolve().parents[1]
"""The project: where ``fab`` finds its tasks."""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one run took: seconds on the clock, and of CPU; ``peak`` memory and bytes ``sent`` where they were asked."""

    seconds: float
    cpu: float
    peak: int = 0
    sent: int = 0


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Runs of fleet's way and of the usual one, taken in turn."""

    fleet: tuple[Cost, ...]
    usual: tuple[Cost, ...]

    @property
    def ratios(self) -> tuple[float, ...]:
        """How many times as long as the usual way fleet took, pair by pair."""
        return tuple(a.seconds / b.seconds for a, b in zip(self.fleet, self.usual, strict=True))

    @property
    def ratio(self) -> float:
        """The median of `ratios`."""
        return statistics.median(self.ratios)

    @property
    def medians(self) -> tuple[float, float]:
        """The median seconds of either way."""
        return seconds(self.fleet), seconds(self.usual)


def compare(
    fleet: Callable[[], Cost], usual: Callable[[], Cost], *, rounds: int, within: float = float("inf")
) -> Pairs:
    """Take both ways in turn: so many rounds, or fewer (two at least) where they take longer than ``within`` seconds."""
    started, both = time.monotonic(), [(fleet(), usual()), (fleet(), usual())]
    while len(both) < rounds and time.monotonic() - started < within:
        both.append((fleet(), usual()))
    return Pairs(fleet=tuple(a for a, _ in both), usual=tuple(b for _, b in both))


def seconds(runs: Sequence[Cost]) -> float:
    """The median of their times."""
    return statistics.median(run.seconds for run in runs)


def cpu_per_gigabyte(runs: Sequence[Cost]) -> float:
    """The median of the CPU seconds for 10^9 bytes sent."""
    return statistics.median(run.cpu / run.sent * 1e9 for run in runs)


def spend(*commands: Sequence[str], environment: Mapping[str, str], limit: float = 180) -> tuple[Cost, str]:
    """Run commands side by side in the project's folder until the last has ended; their cost, and the first's output.

    Raises ``RuntimeError`` with what it said where one fails or takes longer than ``limit`` seconds.
    """
    before, started = _children(), time.monotonic()
    running = [
        subprocess.Popen(
            command,
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        for command in commands
    ]
    try:
        said = [one.communicate(timeout=limit) for one in running]
    except subprocess.TimeoutExpired as late:
        raise RuntimeError(f"{late.cmd!r} took longer than {limit:g} s") from None
    finally:
        for one in (one for one in running if one.poll() is None):
            os.killpg(one.pid, signal.SIGKILL)
            one.communicate()
    took = Cost(seconds=time.monotonic() - started, cpu=_children() - before)
    for one, (out, err) in zip(running, said, strict=True):
        if one.returncode:
            raise RuntimeError(f"{one.args!r} ended with code {one.returncode}: {(err or out).strip()}")
    return took, said[0][0]


def _children() -> float:
    """CPU seconds of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
