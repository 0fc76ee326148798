"""Power that fails while a robot changes its containers: after boot, and without anybody, one release runs, whole."""

from __future__ import annotations

import os
import random
import time
from typing import TYPE_CHECKING

import pytest

from fleet.lab import lifecycle
from tests.lab.conftest import made
from tests.support.lab_project import LAB, QUICK, Project, eventually, service, wipe
from tests.support.sd_card import SdCard
from tests.support.swap_state import asked, containers, note, policies, state, whole

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.lab.conftest import Lab, Pi

TIMES = int(os.environ.get("FLEET_FAULTS", "3"))
"""How often each fault is injected; one takes about 20 s. `make test-faults` sets more."""

SEED = int(os.environ.get("FLEET_SEED", "28"))
SERVICES = ("camera", "driver", "planner")


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SdCard]:
    """Where the robot's files are."""
    one = SdCard(tmp_path_factory.mktemp("card"))
    yield one
    one.remove()


@pytest.fixture(scope="module")
def robot(card: SdCard, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """One virtual Pi whose files are on the card, with Docker."""
    name, directory = f"{LAB}-power", tmp_path_factory.mktemp("power")
    lifecycle.down(directory=directory, name=name, say=print)
    lab = made(name, directory, count=1)
    card.put_into(lab.pis[0])
    assert eventually(lambda: lab.pis[0].ssh("true").returncode == 0, within=60)
    project = Project.made(tmp_path_factory.mktemp("provision"), lab)
    project.well("trust", "--yes")
    project.well("provision", within=900)
    yield lab
    lifecycle.down(directory=directory, name=name, say=print)


@pytest.fixture
def pi(robot: Lab) -> Pi:
    """The robot that the faults happen to."""
    wipe(robot.pis[0])
    return robot.pis[0]


@pytest.fixture
def project(robot: Lab, images: None, tmp_path: Path) -> Project:  # noqa: ARG001  they must be there
    """Three services, of which one waits for another: a swap of some seconds, in which Compose stops, removes and starts."""
    made = Project.made(tmp_path, robot)
    after = "depends_on: {driver: {condition: service_healthy}}"
    made.stack(camera=service(), driver=service(check="sleep 0.5", times=QUICK), planner=service(more=after))
    made.inventory()
    return made


def one_release(project: Project, pi: Pi, where: str) -> None:
    """One release, all of its services, nothing half made; and the next ship converges."""
    if not eventually(lambda: whole(pi, SERVICES), within=90):
        pytest.fail(f"{where}: {state(pi)}", pytrace=False)
    assert policies(pi) == {"unless-stopped"}, (where, state(pi))
    project.well("ship", "--hosts", pi.name, within=180)
    assert whole(pi, SERVICES), (where, state(pi))
    assert eventually(lambda: len(containers(pi)) == len(SERVICES)), (where, state(pi))


@pytest.mark.parametrize("verb", ["ship", "rollback", "restart"])
def test_power_cuts_in_a_swap(
    project: Project, pi: Pi, card: SdCard, verb: str, record_property: Callable[[str, object], None]
) -> None:
    """At any moment of it. Whether it goes forward or back is the robot's choice."""
    for colour in ("0", "1"):
        project.colour(colour)
        project.well("ship", "--hosts", pi.name, within=180)
    moments = random.Random(f"{SEED} {verb}")  # noqa: S311  not for secrets
    times = TIMES if verb == "ship" else max(1, TIMES // 3)
    for number in range(1, times + 1):
        if verb == "ship":
            project.colour(str(number + 1))
        moment = moments.uniform(0, 5)
        retry = ("--retry-for", "0") if verb == "ship" else ()
        with project.start(verb, "--hosts", pi.name, *retry) as fab:
            fab.await_text("restart release" if verb == "restart" else "start release", within=90)
            time.sleep(moment)
            card.cut_power(pi)
        one_release(project, pi, f"cut {number}, {moment:.2f} s after the start (seed {SEED})")
    note(record_property, fault=f"power cut in a {verb}", times=times, end="one release, whole, unaided")


@pytest.mark.parametrize("end", ["Ctrl-C", "kill -9"])
def test_a_desktop_that_goes_away_in_a_swap(
    project: Project, pi: Pi, end: str, record_property: Callable[[str, object], None]
) -> None:
    """The swap is the robot's own work: it ends there, and the next command finds one release."""
    project.colour("0")
    project.well("ship", "--hosts", pi.name, within=180)
    moments = random.Random(f"{SEED} {end}")  # noqa: S311  not for secrets
    times = max(2, TIMES // 2)
    for number in range(1, times + 1):
        project.colour(str(number))
        moment = moments.uniform(0, 3)
        with project.start("ship", "--hosts", pi.name) as fab:
            fab.await_text("start release", within=90)
            time.sleep(moment)
            if end == "Ctrl-C":
                fab.ctrl_c()
                fab.end(within=30)
        one_release(project, pi, f"{end} {number}, {moment:.2f} s after the start (seed {SEED})")
    note(
        record_property,
        fault=f"{end} of `fab ship` in a swap",
        times=times,
        end="one release, whole, unaided",
    )


def test_two_people_on_one_robot(
    project: Project, pi: Pi, record_property: Callable[[str, object], None]
) -> None:
    """Any two verbs at once: in the end the robot has what one of the two wanted, whole."""
    chance = random.Random(SEED)  # noqa: S311  not for secrets
    for colour in ("0", "1"):
        project.colour(colour)
        project.well("ship", "--hosts", pi.name, within=180)
    verbs = ("ship", "ship", "rollback", "restart", "stop", "start", "prune")
    for number in range(1, TIMES + 1):
        pair = chance.choice(verbs), chance.choice(verbs)
        where = f"pair {number}: {pair[0]} and {pair[1]} (seed {SEED})"
        project.colour(f"{number}a")
        with project.start(pair[0], "--hosts", pi.name) as one:
            time.sleep(chance.uniform(0, 2))
            project.colour(f"{number}b")
            with project.start(pair[1], "--hosts", pi.name) as other:
                said = one.end(within=240), other.end(within=240)
        assert all("Traceback" not in each.all for each in said), (where, said)
        assert asked(pi, "cat ~pi/.fleet/stacks/*/journal 2>/dev/null") == "", (where, state(pi))
        if "stop" in pair:
            assert whole(pi, SERVICES) or not containers_running(pi), (where, state(pi), said)
        else:
            assert whole(pi, SERVICES), (where, state(pi), said)
        one_release_after(project, pi, where)
    note(
        record_property,
        fault="two people, any two verbs at once",
        times=TIMES,
        end="one of the two wishes, whole",
    )


def containers_running(pi: Pi) -> list[str]:
    return [line for line in containers(pi) if " Up " in line]


def one_release_after(project: Project, pi: Pi, where: str) -> None:
    """The next ship finds nothing that it trips over."""
    project.well("ship", "--hosts", pi.name, within=180)
    assert whole(pi, SERVICES), (where, state(pi))
