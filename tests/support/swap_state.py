"""In what state did a fault leave the containers of a robot?"""

from __future__ import annotations

import json
import subprocess
from typing import TYPE_CHECKING

from tests.support.lab_project import current, running

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.lab.conftest import Pi


def whole(pi: Pi, services: Sequence[str]) -> bool:
    """Whether these services run and no others, all of the current release, and no swap is under way."""
    journal = asked(
        pi, "cat ~pi/.fleet/stacks/*/journal 2>/dev/null; docker version >/dev/null 2>&1 || echo no"
    )
    if journal:
        return False
    there = running(pi)
    return sorted(there) == sorted(services) and {release for _, release in there.values()} == {current(pi)}


def containers(pi: Pi) -> list[str]:
    """Every container, also those that do not run."""
    return asked(pi, "docker ps --all --format '{{.Names}} {{.Status}}'").splitlines()


def policies(pi: Pi) -> set[str]:
    """The restart policies of what runs."""
    form = "{{.HostConfig.RestartPolicy.Name}}"
    return set(asked(pi, f"docker ps --quiet | xargs docker inspect --format '{form}'").split())


def state(pi: Pi) -> str:
    """What is there, for a person who looks for the reason."""
    return asked(
        pi,
        "docker ps --all --format '{{.Names}} {{.Status}} {{.Label \"fleet.release\"}}'; ls -l ~pi/.fleet/stacks/*/;"
        " cat ~pi/.fleet/stacks/*/journal; tail -n 5 ~pi/.fleet/stacks/*/history; systemctl status fleet-finish;"
        " tail -n 4 ~pi/.fleet/runs/*/errors ~pi/.fleet/runs/*/out; ls -lat ~pi/.fleet/runs ~pi/.fleet/runs/*;"
        " journalctl -u docker -b --no-pager | tail -n 30",
    )


def asked(pi: Pi, script: str) -> str:
    """What a script of root's prints on a robot, which may be down."""
    argv = ("docker", "exec", pi.container, "sh", "-c", script)
    return subprocess.run(argv, capture_output=True, text=True, check=False).stdout.strip()


def note(record: Callable[[str, object], None], *, fault: str, times: int, end: str) -> None:
    """Say at the end of the tests, and in docs/reliability.md, what was injected, how often, and how it ended."""
    record("fault", json.dumps({"fault": fault, "times": times, "end": end}))
