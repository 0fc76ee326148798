from __future__ import annotations

import os
import random
import re
import subprocess
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import (
    HEAVY,
    HEAVY_SIZE,
    Project,
    Running,
    current,
    eventually,
    on_each,
    processes,
    prove,
    running,
    service,
    spool,
    spooled,
    tags,
    wipe,
)
from tests.support.link_cutter import Cut, Cutter
from tests.support.swap_state import note

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.lab.conftest import Lab, Pi
    from tests.support.lab_project import Said

CUTS = 200 if "FLEET_FAULTS" in os.environ else 80
"""While bytes are on their way; more come as they are loaded, proved and started."""

RATE = 8e6
"""Bytes per second of each link: a good Wi-Fi."""


@pytest.fixture
def links(provisioned: Lab, images: None) -> Iterator[dict[str, Cutter]]:  # noqa: ARG001  they must be there
    """The way to each robot, which can be cut; nothing was shipped to any."""
    on_each(provisioned.pis, wipe)
    with ExitStack() as stack:
        yield {pi.name: stack.enter_context(Cutter(pi.address, 22, rate=RATE)) for pi in provisioned.pis}


@pytest.fixture
def far(provisioned: Lab, links: dict[str, Cutter], tmp_path: Path) -> Project:
    """A project that knows the robots by the ends of their links, and trusts them."""
    text = re.sub("  docker: .*\n", "", provisioned.inventory.read_text())  # a path from there
    text = text.replace("identity_file: ", f"identity_file: {provisioned.directory}/")
    for pi in provisioned.pis:
        text = text.replace(f"address: {pi.address}", f"address: 127.0.0.1, port: {links[pi.name].port}")
    (tmp_path / "far").mkdir()
    lab = replace(provisioned, directory=tmp_path / "far")
    lab.inventory.write_text(text)
    (tmp_path / "project").mkdir()
    project = Project.made(tmp_path / "project", lab)
    project.well("trust", "--yes")
    return project


def sent(links: dict[str, Cutter]) -> int:
    """Bytes that went to all robots, with all that SSH adds."""
    return sum(link.sent for link in links.values())


def early(chance: random.Random, count: int, *, login: int) -> list[Cut]:
    """In the probe, in the release's files, after them; then by turns in a login or a command, and among the layers."""
    mean = HEAVY_SIZE * 0.8 / (count * 3 / 4)
    opening = [
        Cut(after=int(login * chance.uniform(*part))) for part in ((0.7, 0.95), (1.1, 2.4), (1.9, 2.1))
    ]
    small = (Cut(after=chance.randrange(2 * login)) for _ in range(count))
    large = (Cut(after=login + int(chance.uniform(0, 2 * mean))) for _ in range(count))
    return (opening + [next(large if number % 4 else small) for number in range(count)])[:count]


def late(chance: random.Random, fab: Running, robot: str, *, login: int) -> list[Cut]:
    """Once all bytes are there: under each of the other steps, at any time, and in the login after that."""

    def cut(title: str, *, after: int = 0, later: float = 0) -> Cut:
        return Cut(after=after, later=later, when=lambda: fab.wrote(f"{robot}: {title}"))

    return [
        *(cut("load the image into Docker", later=later) for later in (0, chance.uniform(0, 2))),
        *(cut("prove that the image", after=after) for after in (0, chance.randrange(login))),
        *(cut("start release", later=later) for later in (0, chance.uniform(0, 2))),
        cut("start release", after=chance.randrange(login)),
    ]


def cut_under(said: str) -> set[str]:
    """What robots were doing when their link was cut."""
    doing: dict[str, str] = {}
    found = set()
    for robot, text in re.findall(r"^(pi\d): (.*)$", said, re.MULTILINE):
        if "; trying again for" in text:
            found.add(doing.get(robot, "look at"))  # that step is announced for all robots at once
        else:
            doing[robot] = " ".join(text.split()[:2])
    return found


def test_cuts_of_the_link_all_the_way(
    far: Project, links: dict[str, Cutter], record_property: Callable[[str, object], None]
) -> None:
    """One command finishes by itself, and sends hardly more than without them, but for what logging in costs.

    For each cut that is a login and the text of a command; a dry run has one login, and asks its one question in a text
    as long as those of the steps.
    """
    pis, chance = far.lab.pis, random.Random(200)  # noqa: S311  no secret
    far.stack(tick=service(HEAVY))
    before = sent(links)
    far.well("ship", "--dry", "--hosts", "pi1")
    login = sent(links) - before
    far.well("ship", "--hosts", "pi1")
    whole = sent(links) - before - login
    wipe(pis[0])
    before = sent(links)
    shares = [CUTS // len(pis) + (number < CUTS % len(pis)) for number in range(len(pis))]
    for pi, share in zip(pis, shares, strict=True):
        links[pi.name].todo = early(chance, share, login=login)
    with far.start("ship", "--json") as fab:
        for pi in pis:
            link = links[pi.name]
            # The files of a release are few: by bytes alone, a cut may miss them.
            files = Cut(after=0, when=partial(fab.wrote, f"{pi.name}: write release"))
            link.todo = [link.todo[0], files, *link.todo[1:], *late(chance, fab, pi.name, login=login)]
        said = fab.end(within=240)
    cuts = sum(link.cuts for link in links.values())
    assert (said.code, said.status) == (0, dict.fromkeys(links, "done")), said.all
    record_property("shown", f"{cuts} cuts injected, all finished")
    note(
        record_property,
        fault="cut of the link, in any step of a ship",
        times=cuts,
        end="the same command finished",
    )
    assert cuts >= CUTS
    assert sent(links) - before < 1.1 * whole * len(pis) + cuts * login
    for pi in pis:
        prove(pi)
        assert (running(pi)["tick"][1], spool(pi)) == (current(pi), "")
        assert len(tags(pi)) == 1
    doing = cut_under(said.err)
    assert doing >= {"look at", "write release", "load the", "start release"}
    assert any(words.startswith("send ") for words in doing)


def release_before(project: Project, *pis: Pi) -> dict[str, str]:
    """Ship a good release, and have the next one bring the heavy image; what is current on each."""
    project.colour("red")
    project.well("ship", "--hosts", ",".join(pi.name for pi in pis))
    project.stack(tick=service(HEAVY))
    return {pi.name: current(pi) for pi in pis}


def runs(pi: Pi, release: str) -> None:
    """It is the current one, it runs, and whatever has a name is whole."""
    assert current(pi) == release
    assert eventually(lambda: running(pi).get("tick", ("", ""))[1] == release)
    for name in tags(pi):
        prove(pi, name)


def finished(project: Project, before: dict[str, str], said: Said) -> dict[str, int]:
    """All have the new release, whole, and nothing is left of its way there. The bytes that were sent to each."""
    assert (said.code, said.status) == (0, dict.fromkeys(before, "done")), said.all
    for pi in project.lab.pis:
        if pi.name in before:
            assert current(pi) != before[pi.name]
            runs(pi, current(pi))
            assert (len(tags(pi)), spool(pi)) == (2, "")
    return {outcome["robot"]: outcome["sent"] for outcome in said.json}


def power(pi: Pi, verb: str) -> None:
    """Take a robot's power away (kill), or give it back (start)."""
    subprocess.run(("docker", verb, pi.container), capture_output=True, check=True)


@pytest.mark.parametrize("retry_for", ["0", "180"], ids=["the same command again", "the running command"])
def test_power_that_fails_during_the_load(project: Project, pi: Pi, retry_for: str) -> None:
    """The release before runs again by itself, and nothing of what had come is sent a second time."""
    before = release_before(project, pi)
    ship = ("ship", "--hosts", "pi1", "--json")
    with project.start(*ship, "--retry-for", retry_for) as fab:
        fab.await_text("pi1: load the image into Docker")
        power(pi, "kill")
        if retry_for == "0":
            assert fab.end(within=40).status == {"pi1": "failed"}
        power(pi, "start")
        if retry_for == "0":
            docker_is_up(pi)
            runs(pi, before["pi1"])
        said = project.fab(*ship) if retry_for == "0" else fab.end(within=150)
    most = 100_000 if retry_for == "0" else HEAVY_SIZE * 1.1
    assert finished(project, before, said)["pi1"] < most


def docker_is_up(pi: Pi) -> None:
    """Wait for the engine of a Pi that boots."""
    pi.exec("timeout", "60", "sh", "-c", "until docker version > /dev/null 2>&1; do sleep 0.2; done")


def test_a_spool_that_is_damaged_between_two_ships(project: Project) -> None:
    """Bytes that were flipped, cut off or added: each is noticed, and costs at most one transfer more."""
    pis = project.lab.pis
    before = release_before(project, *pis)
    with project.start(
        "ship", "--limit", "40Mbit"
    ) as fab:  # slow: the first robot must not be through before the last begins
        assert all(eventually(lambda pi=pi: spooled(pi) > 8_000_000, within=60) for pi in pis)  # type: ignore[misc]
        fab.ctrl_c()
        fab.end(within=5)
    assert eventually(lambda: not any(processes(pi, "receive what is missing") for pi in pis))
    largest = "f=$(ls -S ~pi/.fleet/spool/[0-9a-f]* | head -n 1)"
    for pi, damage in zip(
        pis,
        (
            "printf flipped | dd of=$f bs=1 seek=5000000 conv=notrunc status=none",
            "truncate --size 5000000 $f",
            "head -c 100000 /dev/urandom >> $f",
        ),
        strict=True,
    ):
        pi.exec("sh", "-c", f"{largest}; {damage}")
        runs(pi, before[pi.name])
    arrived = [spooled(pi) for pi in pis]
    sent = finished(project, before, project.fab("ship", "--json"))
    rest = [HEAVY_SIZE + 1_500_000 - came for came in arrived]
    assert HEAVY_SIZE < sent["pi1"] < HEAVY_SIZE + rest[0]
    assert sent["pi2"] < rest[1]
    assert HEAVY_SIZE < sent["pi3"] < HEAVY_SIZE + rest[2]


def test_a_disk_that_somebody_else_fills_half_way(project: Project, pi: Pi) -> None:
    """It is said in one sentence; when there is room again, the next ship sends the rest."""
    before = release_before(project, pi)
    pi.exec("sh", "-c", "cd ~pi/.fleet && mkdir -p spool && mount -t tmpfs -o size=50m,uid=1000 tmpfs spool")
    try:
        with project.start("ship", "--hosts", "pi1", "--json", "--limit", "80Mbit") as fab:
            assert eventually(lambda: spooled(pi) > 5_000_000, within=60)
            pi.exec("sh", "-c", "head -c 60M /dev/zero > ~pi/.fleet/spool/lock.theirs || true")
            said = fab.end(within=60)
        assert (said.code, said.json[0]["reason"]) == (1, "the robot's disk is full"), said.all
        runs(pi, before["pi1"])
        pi.exec("sh", "-c", "rm ~pi/.fleet/spool/lock.theirs")
        arrived = spooled(pi)
        assert arrived > 5_000_000
        sent = finished(project, before, project.fab("ship", "--hosts", "pi1", "--json"))
    finally:
        pi.exec("sh", "-c", "cd ~pi/.fleet && umount spool && chown pi: spool")
    assert sent["pi1"] < HEAVY_SIZE + 1_500_000 - arrived


def test_another_desktop_goes_on(project: Project, pi: Pi, tmp_path: Path) -> None:
    """Ctrl-C in mid-send, and the same command where nothing was packed yet: only the rest is sent."""
    before = release_before(project, pi)
    with project.start("ship", "--hosts", "pi1", "--limit", "80Mbit") as fab:
        assert eventually(lambda: spooled(pi) > 10_000_000, within=60)
        fab.ctrl_c()
        fab.end(within=5)
    assert eventually(lambda: not processes(pi, "receive what is missing"))
    runs(pi, before["pi1"])
    arrived = spooled(pi)
    other = {"XDG_CACHE_HOME": str(tmp_path / "another")}
    sent = finished(project, before, project.fab("ship", "--hosts", "pi1", "--json", env=other))
    assert HEAVY_SIZE - arrived < sent["pi1"] < HEAVY_SIZE + 1_500_000 - arrived
