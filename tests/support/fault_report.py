"""What was injected, how often, and how did it end? As lines for a terminal and as a page of docs/."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A kind of fault, how many times it was injected, and how each of them ended."""

    fault: str
    times: int
    end: str


def table(faults: Sequence[Fault]) -> str:
    """A Markdown table, in the order of the alphabet: tests end in any. A terminal shows it as well."""
    rows = [
        ("fault", "times", "how each of them ended"),
        *sorted((one.fault, str(one.times), one.end) for one in faults),
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    lines = [
        f"| {' | '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))} |"
        for row in rows
    ]
    lines.insert(1, f"| {' | '.join('-' * width for width in widths)} |")
    return "\n".join(lines)


def page(faults: Sequence[Fault], *, failed: int) -> str:
    """The page docs/reliability.md."""
    verdict = (
        f"{failed} tests of this run FAILED; their faults are not in the table."
        if failed
        else "No test of this run failed."
    )
    return f"""# Reliability

What happens to robots when things go wrong. `make test-faults` injects these faults on virtual Pis (real systemd, sshd
and Docker Engine) and writes this page; nothing in it is written by hand. {verdict}

{table(faults)}

A power cut strikes at a random moment of the swap. The virtual Pi has its home and its Docker on an ext4 file system of its
own, which is shut down without a flush, so everything that was not synced is lost; then the Pi is killed, and booted again.

Moments, places and lies are random. A run is repeated exactly with `FLEET_SEED=28 make test-faults`; another number gives
another run.

`fab provision` installs `fleet-finish.service`, by which a robot finishes an interrupted swap at boot. Without it, Docker
starts the old release again at boot unless the cut came between the removal of the old containers and the start of the
new ones. The next `fab ship` mends that.
"""
