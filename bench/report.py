"""How do measurements read: as a table on the terminal, and as a page of the documentation?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bench.pairs import Pairs

COLUMNS = ("what", "measured", "goal", "met", "how")

_PAGE = """\
# Benchmarks

Written by `make bench` on {when}; do not edit. {machine}

{table}

Two ways of doing the same are measured in turn (A B A B ...) and compared pair by pair; the figure is the median of the
pairs' ratios, their range stands behind it. Times depend on the computer and on what else it does, ratios much less.

- **Streaming.** fleet: what the sending step of `fab ship` does, from the SSH login to the robot's answer; Python's own
  start is not in it. OpenSSH: `docker save IMAGE | ssh pi@ROBOT docker load`, one such pipe per robot, side by side. The
  image is removed from the robots between runs, and written data is synced to disk.
- **Robots** are virtual Pis (`fab lab.up`) on this computer: the link is as fast as it gets, and what unpacks the image
  shares the processors with what sends it. Into `cat > /dev/null` nothing but the way there is measured.
- **Memory** is the peak of the one process that feeds all robots. **CPU** is that process's while it streams, for 10^9
  bytes sent; OpenSSH's is that of `docker save` and `ssh` together. The Docker Engine's own is in neither.
- **`fab status`** asks real sshds on loopback, without Docker, all on this computer, which runs their probes too. The bare
  pool asks the same: `paramiko.SSHClient`, `AutoAddPolicy`, 32 threads. Both are whole processes, from start to end.
- **`fab --list`** is a whole process, its bytecode compiled by an earlier run.
"""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One figure. ``goal`` is the most it may be, None where there is none; ``unit`` follows both."""

    what: str
    value: float
    goal: float | None
    unit: str
    how: str

    @property
    def met(self) -> bool:
        """Whether the figure is within its goal."""
        return self.goal is None or self.value <= self.goal

    def cells(self) -> tuple[str, ...]:
        """As in `COLUMNS`."""
        if self.goal is None:
            return (self.what, _figure(self.value, self.unit), "", "", self.how)
        verdict = "yes" if self.met else "NO"
        return (
            self.what,
            _figure(self.value, self.unit),
            f"at most {_figure(self.goal, self.unit)}",
            verdict,
            self.how,
        )


def ratio(what: str, pairs: Pairs, *, goal: float | None) -> Row:
    """The row of a comparison, with the medians of both ways and the range of the ratios."""
    low, high = min(pairs.ratios), max(pairs.ratios)
    fleet, usual = pairs.medians
    how = f"{fleet:.2f} s and {usual:.2f} s; {len(pairs.ratios)} pairs, {low:.2f}x to {high:.2f}x"
    return Row(what=what, value=pairs.ratio, goal=goal, unit="x", how=how)


def page(rows: Sequence[Row], *, when: str, machine: str) -> str:
    """The page ``docs/benchmarks.md``."""
    return _PAGE.format(when=when, machine=machine, table=table(COLUMNS, [row.cells() for row in rows]))


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as Markdown has it."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (columns, ("---",) * len(columns), *rows))


def _figure(value: float, unit: str) -> str:
    return (
        f"{value:.0f} {unit}"
        if unit == "MB" and value >= 10
        else f"{value:.2f}{unit if unit == 'x' else f' {unit}'}"
    )
