"""How long does fleet take to stream to robots? A process of its own, so that its memory and CPU are its own.

It does what the sending step of `fab ship` does - `fleet.rollout.pool.apply` with `fleet.images.store.Store.archive` as the feed -
and prints what that cost as JSON: from the first connection to the last robot's answer, without Python's own start.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.cli.console import Screen
from fleet.config import inventory
from fleet.images.store import Store
from fleet.plan.step import ImageArchive, Plan, Step
from fleet.rollout.apply import apply
from fleet.rollout.pool import each

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from fleet.plan.outcome import Outcome
    from fleet.plan.step import Feed
    from fleet.rollout.link import Link

MEGABYTE = 1 << 20


def main() -> int:
    """Send, and print the cost; 1 where a robot was not done."""
    asked = _arguments()
    robots = inventory.load(asked.inventory).select(asked.hosts)
    if asked.megabytes:
        size = asked.megabytes * MEGABYTE
        feed: Feed = ImageArchive(image="filler", reference="filler", size=size)
        outcomes, cost = _send(robots, feed, asked.argv, open_feed=_filler)
    else:
        with Store() as store:
            local = store.find(asked.image, robots[0].platform)
            feed = ImageArchive(image=local.reference, reference=asked.reference, size=local.size)
            outcomes, cost = _send(
                robots, feed, asked.argv, open_feed=lambda _: store.archive(local.reference, asked.reference)
            )
    sys.stdout.write(json.dumps({**cost, "peak": _peak(), "sent": sum(one.sent for one in outcomes)}))
    failed = [f"{one.robot}: {one.reason}" for one in outcomes if not one.good]
    sys.stderr.write("\n".join(failed))
    return 1 if failed else 0


def _send(
    robots: tuple[inventory.Robot, ...],
    feed: Feed,
    argv: list[str],
    *,
    open_feed: Callable[[Feed], Iterable[bytes]],
) -> tuple[tuple[Outcome, ...], dict[str, float]]:
    steps = (Step(title="send", argv=tuple(argv), feed=feed, limit=None),)
    with Screen().progress() as progress:

        def work(link: Link) -> Outcome:
            plan = Plan(robot=link.robot.name, summary="sent", steps=steps)
            return apply(plan, link, open_feed=open_feed, progress=progress)

        started, cpu = time.monotonic(), time.process_time()
        outcomes = each(robots, work, progress=progress)
        return outcomes, {"seconds": time.monotonic() - started, "cpu": time.process_time() - cpu}


def _filler(feed: Feed) -> Iterator[bytes]:
    """As many bytes; each piece new, and not of zeros, which would take no memory even if they were kept."""
    for number in range(feed.size // MEGABYTE):
        yield bytes([1 + number % 255]) * MEGABYTE


def _peak() -> int:
    """The most memory this process ever had, in bytes. (What getrusage says counts the parent's as well.)"""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text(encoding="utf-8"))
    return int(found[1]) * 1024 if found else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench.sender")
    parser.add_argument("--inventory", type=Path, required=True)
    parser.add_argument("--hosts", default="all")
    parser.add_argument("--image", help="the local image to send")
    parser.add_argument("--reference", help="the name it gets on the robots")
    parser.add_argument("--megabytes", type=int, default=0, help="send so much filler instead")
    parser.add_argument("argv", nargs="+", help="the command that reads them")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
