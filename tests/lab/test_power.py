"""Power that fails while a robot changes its containers: after boot, and without anybody, one release runs, whole."""

from __future__ import annotations

import os
import random
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import QUICK, Project, current, eventually, running, service, wipe

if TYPE_CHECKING:
    from pathlib import Path

    from tests.lab.conftest import Lab, Pi

CUTS = int(os.environ.get("FLEET_POWER_CUTS", "8"))
"""How many; each takes about 20 s. `make test-faults` sets more."""

SEED = int(os.environ.get("FLEET_SEED", "28"))
SERVICES = ("camera", "driver", "planner")


@pytest.fixture
def project(provisioned: Lab, images: None, tmp_path: Path) -> Project:  # noqa: ARG001  they must be there
    """Three services, of which one waits for another: a swap of some seconds, in which Compose stops, removes and starts."""
    made = Project.made(tmp_path, provisioned)
    after = "depends_on: {driver: {condition: service_healthy}}"
    made.stack(camera=service(), driver=service(check="sleep 0.5", times=QUICK), planner=service(more=after))
    made.inventory()
    return made


def test_power_cuts_in_a_swap(project: Project) -> None:
    """Whether it goes forward or back: one release, all of its services, nothing half made; the next ship converges."""
    (pi, *_) = project.lab.pis
    wipe(pi)
    project.colour("0")
    project.well("ship", "--hosts", pi.name, within=180)
    moments = random.Random(SEED)  # noqa: S311  not for secrets
    for number in range(1, CUTS + 1):
        project.colour(str(number))
        moment = moments.uniform(0, 5)
        with project.start("ship", "--hosts", pi.name, "--retry-for", "0") as fab:
            fab.await_text("start release", within=90)
            time.sleep(moment)
            power(pi, "kill")
        power(pi, "start")
        where = f"cut {number}, {moment:.2f} s after the start (seed {SEED})"
        assert eventually(lambda: whole(pi), within=90), (where, state(pi))
        assert policies(pi) == {"unless-stopped"}, (where, state(pi))
        project.well("ship", "--hosts", pi.name, within=180)
        assert whole(pi), (where, state(pi))
        assert eventually(lambda: len(containers(pi)) == len(SERVICES)), (where, state(pi))


def power(pi: Pi, verb: str) -> None:
    """Take a robot's power away (kill), or give it back (start)."""
    subprocess.run(("docker", verb, pi.container), capture_output=True, check=True)


def whole(pi: Pi) -> bool:
    """Whether every service runs, all of the current release, and no swap is under way."""
    if (
        asked(pi, "cat ~pi/.fleet/stacks/*/journal 2>/dev/null; docker version >/dev/null 2>&1 || echo no")
        != ""
    ):
        return False
    there = running(pi)
    return sorted(there) == list(SERVICES) and {release for _, release in there.values()} == {current(pi)}


def containers(pi: Pi) -> list[str]:
    return asked(pi, "docker ps --all --format '{{.Names}} {{.Status}}'").splitlines()


def policies(pi: Pi) -> set[str]:
    form = "{{.HostConfig.RestartPolicy.Name}}"
    return set(asked(pi, f"docker ps --quiet | xargs docker inspect --format '{form}'").split())


def state(pi: Pi) -> str:
    """What is there, for a person who looks for the reason."""
    return asked(
        pi,
        "docker ps --all --format '{{.Names}} {{.Status}} {{.Label \"fleet.release\"}}'; ls -l ~pi/.fleet/stacks/*/;"
        " cat ~pi/.fleet/stacks/*/journal; tail -n 5 ~pi/.fleet/stacks/*/history; systemctl status fleet-finish;"
        " tail ~pi/.fleet/runs/*/errors",
    )


def asked(pi: Pi, script: str) -> str:
    done = subprocess.run(
        ("docker", "exec", pi.container, "sh", "-c", script), capture_output=True, text=True, check=False
    )
    return done.stdout.strip()
