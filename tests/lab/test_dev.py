"""A saved file is heard from every robot. ``FLEET_DEV_TIMES=20`` saves it so often; `make bench-dev` does that."""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import time
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Robot
from fleet.errors import RobotError
from fleet.images.emulation import desktop_platform
from fleet.ros import listen
from tests.support.lab_project import LAB, Project, current, eventually, forget, on_each, running, wipe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.lab.conftest import Lab, Pi
    from tests.support.lab_project import Running

IMAGE = f"{LAB}-dev"
ALL = ("pi1", "pi2", "pi3")
TIMES = int(os.environ.get("FLEET_DEV_TIMES", "3"))
CLOCK = "talker/src/talker/clock.py"


@pytest.fixture(scope="module")
def talking(provisioned: Lab, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Project]:
    """This repository's own stack on every robot, for this computer's processor: nothing here is about ARM."""
    on_each(provisioned.pis, wipe)
    project = Project.copied(tmp_path_factory.mktemp("dev"), provisioned, image=IMAGE)
    platform = f'fleet: {{robots: ["*"], platform: {desktop_platform()}}}'
    project.edit("inventory.yaml", 'fleet: ["*"]', platform)
    project.well("build", "--hosts", "fleet", within=900)
    project.well("ship", "--hosts", "fleet", within=400)
    yield project
    on_each(provisioned.pis, wipe)
    forget(IMAGE)


@pytest.fixture
def dev(talking: Project) -> Iterator[Running]:
    """`fab dev` on all robots, which have what this computer has."""
    with talking.start("dev", "--hosts", "fleet") as fab:
        for name in ALL:
            fab.await_text(f"{name}: in step; talker healthy")
        yield fab


def say(project: Project, word: str) -> None:
    """Let the node say something else from now on, as an editor saves it."""
    path = project.directory / CLOCK
    text = re.sub(
        r'return (".*" \+ )?moment\.isoformat', f'return "{word} " + moment.isoformat', path.read_text()
    )
    (path.with_name(".clock.py.swp")).write_text(text)
    path.with_name(".clock.py.swp").replace(path)


def hear(pi: Pi, good: Callable[[str], bool], *, within: float = 120.0) -> float:
    """When the first message came that is good."""
    robot, end = Robot(name=pi.name, address=pi.address), time.monotonic() + within
    while time.monotonic() < end:
        try:
            with closing(listen.messages(robot, "time", timeout=5)) as arriving:
                for message in arriving:
                    if good(message.text()):
                        return time.monotonic()
                    if time.monotonic() > end:
                        break
        except RobotError:
            time.sleep(0.02)
    raise AssertionError(f"nothing good from {pi.name} in {within:g} s")


def saying(word: str) -> Callable[[Pi], float]:
    """When a robot has said a word."""
    return lambda pi: hear(pi, lambda text: word in text)


def stack(project: Project, name: str) -> dict[str, object]:
    """What `fab status` says of the stack of a robot."""
    found: dict[str, object] = project.fab("status", "--json").json[name]["fleet"]["stacks"]["talker"]
    return found


def bare(project: Project) -> float:
    """Seconds from `docker restart` by hand to the first message, on all robots at once: nothing can be faster."""
    began = time.monotonic()

    def restart(pi: Pi) -> float:
        pi.exec("docker", "restart", running(pi)["talker"][0])
        return hear(pi, bool)

    return max(on_each(project.lab.pis, restart)) - began


def test_a_saved_edit_is_heard_from_every_robot(
    talking: Project, dev: Running, capsys: pytest.CaptureFixture[str]
) -> None:
    """Within 3 s, or half as much again as a bare restart takes, and a second, while this computer is busy."""
    took, least = [], []
    for number in range(TIMES):
        word = f"edit{number}"
        began = time.monotonic()
        say(talking, word)
        took.append(max(on_each(talking.lab.pis, saying(word))) - began)
        least.append(bare(talking))
    with capsys.disabled():
        print(  # noqa: T201  the figure is a result
            f"\nfab dev, {len(ALL)} robots, from a save to the last robot's first message, {TIMES} times: median"
            f" {statistics.median(took):.1f} s, longest {max(took):.1f} s"
            f" (a bare `docker restart`: median {statistics.median(least):.1f} s, longest {max(least):.1f} s)"
        )
    assert statistics.median(took) <= max(3.0, 1.5 * statistics.median(least) + 1.0)
    dev.ctrl_c()
    assert dev.end().code == 0


def test_a_robot_says_that_it_is_in_dev_until_a_ship(talking: Project, dev: Running) -> None:
    """Who and since when. Ctrl-C leaves it so; the same release is shipped, and not `unchanged`; the second time it is."""
    say(talking, "in dev")
    on_each(talking.lab.pis, lambda pi: hear(pi, lambda text: "in dev" in text))
    dev.ctrl_c()
    assert "still in dev: pi1,pi2,pi3" in dev.end().err
    state = stack(talking, "pi2")["dev"]
    assert isinstance(state, dict)
    assert sorted(state) == ["by", "since"]
    assert ", dev by " in talking.fab("status").out
    before = [current(pi) for pi in talking.lab.pis]
    ended = talking.well("dev", "--end", "--hosts", "pi1", "--json").status
    assert ended == {"pi1": "done"}
    shipped = [talking.well("ship", "--hosts", "fleet", "--json", within=200).status for _ in range(2)]
    assert shipped == [{"pi1": "unchanged", "pi2": "done", "pi3": "done"}, dict.fromkeys(ALL, "unchanged")]
    assert [current(pi) for pi in talking.lab.pis] == before
    on_each(talking.lab.pis, lambda pi: hear(pi, lambda text: "in dev" not in text))
    assert [stack(talking, name)["dev"] for name in ALL] == [None, None, None]


def test_a_reboot_brings_the_release_back(talking: Project, dev: Running) -> None:
    """Nobody is there with `fab dev`: the robot does it at boot."""
    pi = talking.lab.pis[0]
    say(talking, "for the boot")
    hear(pi, lambda text: "for the boot" in text)
    dev.ctrl_c()
    dev.end()
    subprocess.run(("docker", "restart", "--time", "5", pi.container), capture_output=True, check=True)
    assert eventually(
        lambda: pi.exec("sh", "-c", "ls ~pi/.fleet/stacks/talker/dev 2>&1 || true").startswith("ls:"),
        within=120,
    )
    hear(pi, lambda text: "for the boot" not in text)
    talking.well("dev", "--end", "--hosts", "fleet")
    assert [event["verb"] for event in talking.well("history", "--hosts", "pi1", "--json").json["pi1"]][
        -1
    ] == "boot"
