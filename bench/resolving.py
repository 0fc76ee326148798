"""How long does Compose take to read a stack for many robots, each with values of its own?"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from bench.pairs import seconds, spend
from bench.report import Row

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FAB = str(Path(sys.executable).with_name("fab"))
SERVICES = 5


def rows(
    counts: Sequence[int], *, folder: Path, environment: Mapping[str, str], rounds: int
) -> tuple[Row, ...]:
    """A row for each number of robots: `fab build --dry`, a whole process, from its start to its end."""
    return tuple(
        _row(count, folder=folder / f"{count} robots", environment=environment, rounds=rounds)
        for count in counts
    )


def _row(count: int, *, folder: Path, environment: Mapping[str, str], rounds: int) -> Row:
    folder.mkdir()
    node = {"image": "node:${TAG:-1}", "environment": {"NAME": "${NAME}"}, "restart": "unless-stopped"}
    services = {f"node{number}": node for number in range(SERVICES)}
    (folder / "compose.yaml").write_text(
        json.dumps({"name": "rover", "services": services}), encoding="utf-8"
    )
    robots = {
        f"pi{number}": {
            "address": f"10.0.{number // 250}.{number % 250 + 1}",
            "environment": {"NAME": f"pi{number}"},
        }
        for number in range(count)
    }
    inventory = folder / "inventory.yaml"
    inventory.write_text(json.dumps({"stack": "compose.yaml", "robots": robots}), encoding="utf-8")
    command = (FAB, "build", "--dry", "--inventory", str(inventory))
    runs = [spend(command, environment=environment)[0] for _ in range(rounds)]
    what = f"Compose reads {SERVICES} services for {count} robot{'s' * (count != 1)} with values of their own"
    return Row(
        what=what, value=seconds(runs), goal=None, unit="s", how=f"`fab build --dry`, median of {rounds}"
    )
