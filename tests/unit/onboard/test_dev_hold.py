"""The script runs for real, on the Docker of this computer, with a project of a name that nobody else has."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.onboard.exit_codes import BUSY, UNUSABLE
from fleet.plan import dev_steps
from fleet.plan.compose_steps import Request
from fleet.robot.history import history
from tests.support.dev_stack import DevStack, Holding
from tests.support.lab_project import eventually
from tests.support.small_image import make_image

if TYPE_CHECKING:
    from collections.abc import Iterator

FINISH = Path(__file__).parents[3] / "fleet/onboard/finish.service"


@pytest.fixture(scope="module")
def image(desktop: None) -> Iterator[str]:  # noqa: ARG001  it marks the test
    yield from make_image(("sh", "cat", "sleep"))


@pytest.fixture
def robot(tmp_path: Path, image: str) -> Iterator[DevStack]:
    (tmp_path / "home/.fleet").mkdir(parents=True)
    made = DevStack(home=tmp_path / "home", image=image)
    made.start()
    yield made
    made.clear()


def argv(
    robot: DevStack, *, session: str = "5e55", release: str = "one", by: str = "tim@desktop"
) -> tuple[str, ...]:
    request = Request(by=by, run="r", wait=10, settle=1)
    return dev_steps.hold(robot.name, release, session=session, request=request)


@pytest.fixture
def hold(robot: DevStack) -> Iterator[Holding]:
    holding = Holding(robot, argv(robot))
    holding.await_text("ready ")
    yield holding
    holding.end()


def boot(robot: DevStack) -> None:
    """What fleet-finish.service runs at boot."""
    (command,) = re.findall(r"ExecStart=/bin/sh -c '(.*)'", FINISH.read_text())
    assert robot.run(("sh", "-c", command.replace("$$", "$"))).returncode == 0


def told(robot: DevStack) -> list[tuple[str, str]]:
    lines = tuple((robot.folder / "history").read_text().splitlines())
    return [(one.verb, one.outcome) for one in history(lines)]


def test_a_stack_is_in_dev_until_somebody_ends_it(robot: DevStack, hold: Holding) -> None:
    """Who and since when is written there; the connection that ends leaves it; a ship of the same release ends it."""
    since, _, by = (robot.dev / "state").read_text().strip().partition(" ")
    assert re.fullmatch(r"[0-9-]{10}T[0-9:]{8}Z", since)
    assert by == "tim@desktop"
    hold.await_text("states node,running,0,0,none")
    before = robot.ids
    hold.end()
    assert (robot.dev / "state").exists()
    assert robot.swap("ship").returncode == 0
    assert robot.ids != before
    assert not robot.dev.exists()
    assert not list((robot.home / ".fleet/runs").iterdir())


def test_the_holder_hears_that_dev_has_ended(robot: DevStack, hold: Holding) -> None:
    """With the line of the history that says who."""
    robot.swap("dev")
    hold.await_text("ended 2")
    assert "dev one tim@desktop done" in hold.text
    assert hold.process.wait(10) == 0


@pytest.mark.parametrize("verb", ["start", "restart"])
def test_a_restart_stays_in_dev(robot: DevStack, hold: Holding, verb: str) -> None:
    """The containers are the same, and so is what was synced."""
    before = robot.ids
    assert robot.swap(verb).returncode == 0
    assert robot.ids == before
    assert (robot.dev / "state").exists()
    assert "ended" not in hold.text


def test_a_reboot_brings_the_release_back(robot: DevStack, hold: Holding) -> None:
    """The prepared run does it once; it was not started before."""
    hold.end()
    before = robot.ids
    (run,) = (robot.home / ".fleet/runs").iterdir()
    assert run.name == (robot.dev / "back").read_text().strip()
    assert not (run / "code").exists()
    boot(robot)
    assert eventually(lambda: not robot.dev.exists())
    assert (run / "code").read_text() == "0\n"
    assert robot.ids != before
    assert told(robot) == [("ship", "done"), ("boot", "done")]
    boot(robot)
    assert told(robot) == [("ship", "done"), ("boot", "done")]


def test_what_a_person_has_stopped_stays_stopped_over_a_reboot(robot: DevStack, hold: Holding) -> None:
    """Nobody wants motors back with the power. It is in dev still."""
    assert robot.swap("stop").returncode == 0
    hold.end()
    boot(robot)
    assert told(robot) == [("ship", "done"), ("stop", "done")]
    running = ("docker", "inspect", "--format", "{{.State.Running}}", *robot.ids)
    assert subprocess.run(running, capture_output=True, text=True, check=True).stdout == "false\n"
    assert (robot.dev / "state").exists()
    assert robot.swap("start").returncode == 0
    boot(robot)
    assert eventually(lambda: not robot.dev.exists())
    assert told(robot)[-1] == ("boot", "done")


def test_a_power_cut_while_dev_is_ended_at_boot(robot: DevStack, hold: Holding) -> None:
    """The note of dev is gone already, and the containers are not proved yet: the journal says that it goes on."""
    hold.end()
    run = (robot.dev / "back").read_text().strip()
    shutil.rmtree(robot.dev)
    (robot.folder / "journal").write_text(f"swap boot one one 2026-11-28T12:00:00Z tim@desktop\n{run}\n")
    boot(robot)
    assert not (robot.folder / "journal").exists()
    assert told(robot)[-1] == ("boot", "done")


def test_a_swap_that_is_not_finished_comes_first(robot: DevStack) -> None:
    """The containers may be half of one release and half of another."""
    (robot.folder / "journal").write_text("swap ship one - 2026-11-28T12:00:00Z tim@desktop\nrun\n")
    holding = Holding(robot, argv(robot))
    holding.await_text("a start of a release was interrupted here: `fab ship` finishes it")
    holding.end()


def test_a_desktop_that_is_back_before_the_boot_has_ended_goes_on(robot: DevStack, hold: Holding) -> None:
    """Its new connection has prepared another end: the one of before does nothing."""
    hold.end()
    earlier = (robot.dev / "back").read_text().strip()
    again = Holding(robot, argv(robot))
    again.await_text("ready ")
    before = robot.ids
    assert robot.swap("boot", FLEET_RUN=earlier).returncode == 0
    assert robot.ids == before
    assert told(robot) == [("ship", "done")]
    again.end()


def test_what_was_synced_is_told_while_the_containers_are_the_same(robot: DevStack, hold: Holding) -> None:
    """Names with spaces too; after a replacement there is nothing. An upload that was cut is told with its size."""
    hold.end()
    (robot.dev / "has-node").write_text(f"{robot.ids[0]} \nabc.644 /app/a file\n- /app/gone\n")
    (robot.dev / "in-0a1b").write_text("12345")
    again = Holding(robot, argv(robot))
    text = again.await_text("ready ")
    assert "has node abc.644 /app/a file\nhas node - /app/gone\npart 0a1b 5\nready " in text
    again.end()
    robot.run(("sh", "-c", f"cd {robot.folder}/releases/one && docker compose up -d --force-recreate"))
    again = Holding(robot, argv(robot))
    assert "has node" not in again.await_text("ready ")
    again.end()


def test_two_people(robot: DevStack, hold: Holding) -> None:
    """The second is told who has it, and changes nothing. The same session takes over at once: its connection was lost."""
    second = Holding(robot, argv(robot, session="07e5", by="ada@laptop"))
    assert second.end_by_itself() == (BUSY, "tim@desktop has `fab dev` on this robot\n")
    assert (robot.dev / "session").read_text() == "5e55\n"
    again = Holding(robot, argv(robot))
    again.await_text("ready ")
    assert hold.process.wait(10) != 0
    again.end()


def test_another_release_than_was_seen(robot: DevStack) -> None:
    """Somebody shipped in between."""
    second = Holding(robot, argv(robot, release="two"))
    assert second.end_by_itself() == (UNUSABLE, "release one is current now, not two\n")
    assert not (robot.dev / "state").exists()


def test_a_container_that_ends_is_told_with_its_last_lines(robot: DevStack, hold: Holding) -> None:
    """Its own words come before its state."""
    (robot.home / "node").write_text("echo lidar is missing; exit 7\n")
    subprocess.run(
        ("docker", "cp", str(robot.home / "node"), f"{robot.ids[0]}:/app/node"),
        check=True,
        capture_output=True,
    )
    subprocess.run(("docker", "restart", robot.ids[0]), check=True, capture_output=True)
    text = hold.await_text("said node lidar is missing")
    assert eventually(
        lambda: (
            re.search(r"states node,restarting,7,\d+,none", hold.text)
            or re.search(r"states node,running,\d,[1-9]", hold.text)
        )
    )
    assert text.index("ready ") < text.index("said node")
