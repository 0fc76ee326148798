"""The script runs for real, on the Docker of this computer, with a project of a name that nobody else has."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from fleet import onboard
from fleet.robot.history import history
from tests.support.small_image import make_image

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

STAYS = "trap 'exit 0' TERM; while :; do sleep 0.1; done"
CRASHES = "sleep 2; exit 7"


@pytest.fixture(scope="module")
def image(desktop: None) -> Iterator[str]:  # noqa: ARG001  it marks the test
    """An image with a shell."""
    yield from make_image(("sh", "sleep", "cat", "true", "touch", "chown"))


@dataclass(frozen=True)
class Robot:
    """A home directory with one stack in it, and the containers of that stack."""

    home: Path
    image: str
    stack: str = field(default_factory=lambda: f"fleet-test-{uuid.uuid4().hex[:12]}")

    @property
    def folder(self) -> Path:
        return self.home / ".fleet/stacks" / self.stack

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def release(
        self,
        name: str,
        command: str = STAYS,
        *,
        restart: str = "always",
        seeds: Mapping[str, str] | None = None,
        folders: str = "",
        more: Mapping[str, Any] | None = None,
        services: Mapping[str, Any] | None = None,
        policies: str = "",
    ) -> None:
        """Write a release with the service ``node``; ``restart`` is Compose's word and the one in ``services``."""
        folder = self.folder / "releases" / name
        folder.mkdir(parents=True)
        node = {
            "image": self.image,
            "command": ["sh", "-c", command],
            "restart": restart,
            "stop_grace_period": "1s",
            "network_mode": "none",
            "labels": {"fleet.release": name},
            **(more or {}),
        }
        others = {
            key: {"image": self.image, "network_mode": "none", "stop_grace_period": "1s", **value}
            for key, value in (services or {}).items()
        }
        model = {"services": {"node": node, **others}}
        (folder / "compose.yaml").write_text(json.dumps(model))
        (folder / "services").write_text(policies or f"node={restart}\n")
        if folders:
            (folder / "data-folders").write_text(folders)
        for path, text in (seeds or {}).items():
            seed = folder / "seeds" / path
            seed.parent.mkdir(parents=True, exist_ok=True)
            if path.endswith("/"):  # a folder, and its mode
                seed.mkdir()
                seed.chmod(int(text, 8))
            else:
                seed.write_text(text)

    def argv(
        self,
        release: str,
        *,
        verb: str = "ship",
        wait: int = 10,
        settle: int = 1,
        conflict: str = "robot",
        seen: str = "?",
    ) -> tuple[str, ...]:
        numbers = (str(wait), str(settle))
        return ("sh", "-c", onboard.text("swap.sh"), "swap", verb, self.stack, release, seen, "tim@desktop", *numbers, conflict)  # fmt: skip

    @property
    def environment(self) -> dict[str, str]:
        return {"PATH": f"{self.home.parent / 'bin'}:{os.environ['PATH']}", "HOME": str(self.home)}

    def swap(self, release: str, *, turn: int = 20, **words: Any) -> subprocess.CompletedProcess[str]:  # noqa: ANN401
        return subprocess.run(
            self.argv(release, **words),
            env={**self.environment, "FLEET_TURN": str(turn)},
            cwd="/",
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    def containers(self) -> dict[str, str]:
        """Release and state of each container, by its service."""
        form = '{{.Label "com.docker.compose.service"}} {{.Label "fleet.release"}} {{.State}}'
        listing = ("docker", "ps", "--all", "--format", form, "--filter", self.filter)
        lines = subprocess.run(listing, check=True, capture_output=True, text=True).stdout.splitlines()
        return {line.split(" ", 1)[0]: line.split(" ", 1)[1].strip() for line in lines}

    @property
    def filter(self) -> str:
        return f"label=com.docker.compose.project={self.stack}"

    def ids(self) -> list[str]:
        listing = ("docker", "ps", "--all", "--quiet", "--no-trunc", "--filter", self.filter)
        return subprocess.run(listing, check=True, capture_output=True, text=True).stdout.split()

    @property
    def current(self) -> str:
        link = self.folder / "current"
        return str(link.readlink()) if link.is_symlink() else ""

    def told(self) -> list[tuple[str, str, str, str]]:
        """The history, without its times."""
        lines = tuple((self.folder / "history").read_text().splitlines())
        return [(one.verb, one.release, one.by, one.outcome) for one in history(lines)]

    def left(self) -> set[str]:
        """The files of the stack's folder that no command of a person made."""
        return {path.name for path in self.folder.iterdir()} - {"releases", "data"}

    def clear(self) -> None:
        if ids := self.ids():
            subprocess.run(("docker", "rm", "--force", "--volumes", *ids), check=True, capture_output=True)


@pytest.fixture
def robot(tmp_path: Path, image: str) -> Iterator[Robot]:
    """A robot without a release."""
    compose = Path(sys.executable).with_name("docker-compose")
    wrapper = tmp_path / "bin/docker"
    wrapper.parent.mkdir()
    wrapper.write_text(
        f'#!/bin/sh\nif [ "$1" = compose ]; then shift; exec {compose} "$@"; fi\nexec {shutil.which("docker")} "$@"\n'
    )
    wrapper.chmod(0o755)
    (tmp_path / "home/.fleet").mkdir(parents=True)
    made = Robot(home=tmp_path / "home", image=image)
    yield made
    made.clear()


def test_the_first_start(robot: Robot) -> None:
    """The containers run, ``current`` and the history say so, and no journal is left."""
    robot.release("one", folders="maps\nlogs/deep\n")
    done = robot.swap("one")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert robot.containers() == {"node": "one running"}
    assert robot.current == "releases/one"
    assert robot.told() == [("ship", "one", "tim@desktop", "done")]
    assert robot.left() == {"current", "history"}
    assert (robot.data / "maps").is_dir()
    assert (robot.data / "logs/deep").is_dir()


def test_the_second_release_takes_the_place_of_the_first(robot: Robot) -> None:
    """A service that the new release does not have any more is removed."""
    robot.release("one", services={"old": {"command": ["sleep", "60"]}})
    robot.release("two")
    assert robot.swap("one").returncode == 0
    assert set(robot.containers()) == {"node", "old"}
    assert robot.swap("two").returncode == 0
    assert robot.containers() == {"node": "two running"}
    assert robot.current == "releases/two"
    assert robot.told() == [("ship", name, "tim@desktop", "done") for name in ("one", "two")]


def test_the_same_release_twice_keeps_its_containers(robot: Robot) -> None:
    """Nothing is stopped where nothing has changed."""
    robot.release("one")
    assert robot.swap("one").returncode == 0
    before = robot.ids()
    assert robot.swap("one").returncode == 0
    assert robot.ids() == before


def test_a_release_that_crashes_goes_back(robot: Robot) -> None:
    """Why, the last lines of its log, and that the one before runs again; ``current`` never moved."""
    robot.release("one")
    robot.release("two", f"echo lidar is missing; {CRASHES}")
    robot.swap("one")
    done = robot.swap("two", settle=6)
    assert done.returncode == 1
    first, *rest = done.stderr.splitlines()
    ways = (
        "node has restarted",
        "node has restarted (exit code 7)",
        "node ends again and again (exit code 7)",
    )
    assert first in ways
    assert "lidar is missing" in rest
    assert rest[-1] == "went back to release one, which runs"
    assert robot.containers() == {"node": "one running"}
    assert robot.current == "releases/one"
    assert robot.told()[-1] == ("ship", "two", "tim@desktop", f"failed: {first}")
    assert robot.left() == {"current", "history"}


def test_the_first_release_crashes(robot: Robot) -> None:
    """Nothing ran before: it is stopped, and there is no current release."""
    robot.release("one", "exit 3")
    done = robot.swap("one", settle=4)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "stopped it, as nothing ran before"
    assert "running" not in str(robot.containers())
    assert robot.current == ""


def test_a_one_shot_that_ends_well(robot: Robot) -> None:
    """A second ship neither fails nor runs it again."""
    more = {"setup": {"command": ["sh", "-c", "true"], "restart": "no"}}
    robot.release("one", services=more, policies="node=always\nsetup=no\n")
    assert robot.swap("one").returncode == 0
    assert robot.containers() == {"node": "one running", "setup": "exited"}
    before = robot.ids()
    assert robot.swap("one").returncode == 0
    assert robot.ids() == before


def test_a_one_shot_that_others_wait_for(robot: Robot) -> None:
    """``service_completed_successfully``: the node starts after it, and all is well."""
    depends = {"depends_on": {"setup": {"condition": "service_completed_successfully"}}}
    more = {"setup": {"command": ["sh", "-c", "sleep 1"], "restart": "no"}}
    robot.release("one", more=depends, services=more, policies="node=always\nsetup=no\n")
    assert robot.swap("one").returncode == 0
    assert robot.containers() == {"node": "one running", "setup": "exited"}


def test_a_one_shot_that_fails(robot: Robot) -> None:
    """A code other than 0 is a failure, also where Docker does not start it again."""
    robot.release("one", "exit 1", restart="no")
    done = robot.swap("one")
    assert done.returncode == 1
    assert done.stderr.splitlines()[0] == "node has ended with code 1"


def test_a_node_that_ends_with_0_and_should_not(robot: Robot) -> None:
    """Where a service is started again always, its end is no success."""
    robot.release("one", "exit 0")
    assert robot.swap("one", settle=3).returncode == 1


def test_a_service_that_is_not_wanted_may_be_down(robot: Robot) -> None:
    """Only what ``services`` names is watched: replicas may be 0."""
    more = {"none": {"command": ["sh", "-c", "exit 9"], "restart": "no"}}
    robot.release("one", services=more, policies="node=always\n")
    assert robot.swap("one").returncode == 0


def check(command: str, **times: str) -> dict[str, Any]:
    quick = {"interval": "300ms", "timeout": "2s", "retries": 2}
    return {"healthcheck": {"test": ["CMD-SHELL", command], **quick, **times}}


def test_healthy_is_at_once_enough(robot: Robot) -> None:
    """A check that has passed is a proof: the settling time is not waited for."""
    robot.release("one", more=check("true"))
    began = time.monotonic()
    assert robot.swap("one", settle=30, wait=40).returncode == 0
    assert time.monotonic() - began < 15


def test_unhealthy(robot: Robot) -> None:
    """A check that fails is a failure."""
    robot.release("one")
    robot.release("two", more=check("false"))
    robot.swap("one")
    done = robot.swap("two")
    assert done.returncode == 1
    assert done.stderr.splitlines()[0] == "node is unhealthy"
    assert robot.containers() == {"node": "one running"}


@pytest.mark.parametrize(
    "check",
    [["CMD", "sh", "-c", "cat /ready"], ["CMD-SHELL", "cat /nothing ||\n cat /ready"]],
)
def test_health_is_asked_for_before_docker_asks(robot: Robot, check: list[str]) -> None:
    """Docker would ask a minute later; what was proved here is known to the next command."""
    healthcheck = {"test": check, "interval": "60s", "retries": 3}
    robot.release("r1", f"sleep 1; touch /ready; {STAYS}", more={"healthcheck": healthcheck})
    began = time.monotonic()
    done = robot.swap("r1", wait=30)
    assert (done.returncode, done.stderr) == (0, "")
    assert 1 < time.monotonic() - began < 10
    assert (robot.folder / "proved").read_text().split() == robot.ids()


def test_a_release_that_came_meanwhile(robot: Robot) -> None:
    """A ship replaces it and says so, a rollback does nothing, and a restart is one of what is current."""
    for name in ("r1", "r2", "r3"):
        robot.release(name)
    assert robot.swap("r1").returncode == 0
    assert robot.swap("r2", seen="r1").returncode == 0
    done = robot.swap("r1", seen="r1", verb="restart")
    assert "note: restart of release r2, which came after this was planned: " in done.stdout
    assert "ship r2 tim@desktop done" in done.stdout
    assert (done.returncode, robot.containers()) == (0, {"node": "r2 running"})
    done = robot.swap("r3", seen="r1", verb="rollback")
    assert "release r2 is current now, which came after this was planned" in done.stderr
    assert (done.returncode, robot.containers()) == (1, {"node": "r2 running"})
    done = robot.swap("r3", seen="r1")
    assert "note: takes the place of release r2" in done.stdout
    assert (done.returncode, robot.containers()) == (0, {"node": "r3 running"})


def policy(container: str) -> str:
    form = "{{.HostConfig.RestartPolicy.Name}}"
    return subprocess.run(
        ("docker", "inspect", "--format", form, container), check=True, capture_output=True, text=True
    ).stdout.strip()


def test_a_release_that_stays_for_a_power_cut(robot: Robot) -> None:
    """While the new one starts, the old one is a container that Docker starts again at boot; afterwards all is as written."""
    robot.release("r1", restart="unless-stopped", policies="node=always\n")
    robot.release("r2", CRASHES, restart="unless-stopped", policies="node=always\n")
    assert robot.swap("r1").returncode == 0
    (old,) = robot.ids()
    swap = subprocess.Popen(robot.argv("r2", settle=4), env=robot.environment, stdout=-1, stderr=-1)
    policies = set()
    while swap.poll() is None:
        with contextlib.suppress(subprocess.CalledProcessError):
            policies.add(policy(old))
        time.sleep(0.02)
    swap.communicate()
    assert "always" in policies
    (back,) = robot.ids()
    assert (swap.returncode, policy(back)) == (1, "unless-stopped")
    assert not (robot.folder / "policies").exists()


def test_not_healthy_in_time(robot: Robot) -> None:
    """The time is over while its start period is not."""
    robot.release("one", more=check("false", start_period="60s"))
    done = robot.swap("one", wait=2)
    assert done.returncode == 1
    assert done.stderr.splitlines()[0] in [f"node is not healthy yet after {number} s" for number in (2, 3)]


def test_without_a_check_it_has_to_settle(robot: Robot) -> None:
    """It is watched for the whole settling time, which the script counts in whole seconds."""
    robot.release("one")
    began = time.monotonic()
    assert robot.swap("one", settle=3).returncode == 0
    assert time.monotonic() - began >= 2


def test_a_settling_time_longer_than_the_wait(robot: Robot) -> None:
    """``--settle`` is kept also where ``--wait`` is shorter: a good release does not fail for it."""
    robot.release("one")
    done = robot.swap("one", settle=4, wait=1)
    assert (done.returncode, done.stderr) == (0, "")


def test_another_command_holds_the_lock(robot: Robot) -> None:
    """Who that is, is said at once; after the time that a turn may take, the exit code is that of `busy`."""
    robot.release("one")
    (robot.home / ".fleet/holder").write_text("ann@laptop, who runs fab ship since 12:00:00\n")
    with (robot.home / ".fleet/lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = robot.swap("one", turn=1)
    assert done.returncode == 75
    assert done.stdout == "note: waits for ann@laptop, who runs fab ship since 12:00:00\n"
    assert done.stderr == "ann@laptop, who runs fab ship since 12:00:00 has not ended after 1 s\n"
    assert robot.containers() == {}


def test_the_lock_is_free_afterwards(robot: Robot) -> None:
    """No container and no helper of Docker keeps it."""
    robot.release("one")
    robot.swap("one")
    with (robot.home / ".fleet/lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_a_release_that_is_not_there(robot: Robot) -> None:
    """Another command removed it meanwhile: one sentence, and nothing is touched."""
    robot.release("one")
    robot.swap("one")
    before = robot.ids()
    done = robot.swap("gone")
    assert done.returncode == 1
    assert done.stderr == "release gone is not on this robot any more; another command has removed it\n"
    assert (robot.ids(), robot.current) == (before, "releases/one")


def test_half_made_containers_are_cleared(robot: Robot) -> None:
    """A swap that was cut leaves containers that were created only; they are in the way of the next one."""
    robot.release("one")
    labels = {
        "com.docker.compose.project": robot.stack,
        "com.docker.compose.service": "node",
        "com.docker.compose.oneoff": "False",
        "com.docker.compose.container-number": "1",
    }
    options = [part for name, value in labels.items() for part in ("--label", f"{name}={value}")]
    named = ("--name", f"{robot.stack}-node-1")
    create = ("docker", "create", "--network", "none", *named, *options, robot.image, "true")
    made = subprocess.run(create, check=True, capture_output=True, text=True).stdout.strip()
    assert robot.swap("one").returncode == 0
    assert robot.containers() == {"node": "one running"}
    assert made not in robot.ids()


def test_what_a_person_ran_by_hand_is_not_watched(robot: Robot) -> None:
    """``docker compose run`` leaves a container with the service's name, which may have ended badly."""
    robot.release("one")
    robot.swap("one")
    command = ("docker", "compose", "-p", robot.stack, "run", "node", "sh", "-c", "exit 5")
    environment = {**os.environ, **robot.environment}
    by_hand = subprocess.run(
        command, cwd=robot.folder / "current", env=environment, check=False, capture_output=True
    )
    assert by_hand.returncode == 5
    assert robot.swap("one").returncode == 0


def test_a_history_that_a_power_cut_tore(robot: Robot) -> None:
    """NUL bytes and a line without an end stay out of the next line's way."""
    robot.release("one")
    good = "2026-01-01T00:00:00Z\tship\told\ttim@desktop\tdone\n"
    (robot.folder / "history").write_bytes(good.encode() + b"2026-01-01\tsh" + bytes(100))
    robot.swap("one")
    assert robot.told() == [
        ("ship", "old", "tim@desktop", "done"),
        ("ship", "one", "tim@desktop", "done"),
    ]
    assert b"\0" not in (robot.folder / "history").read_bytes()


def test_an_image_that_is_not_there(robot: Robot) -> None:
    """Compose's own words, never a pull from a registry; the one before runs on."""
    robot.release("one")
    robot.release("two", more={"image": "fleet-test-none:gone"})
    robot.swap("one")
    done = robot.swap("two")
    assert done.returncode == 1
    assert "fleet-test-none:gone" in done.stderr.splitlines()[0]
    assert robot.containers() == {"node": "one running"}


def test_stop_start_and_restart(robot: Robot) -> None:
    """Each is one line of the history; a restart makes no failure of its own restart."""
    robot.release("one")
    robot.swap("one")
    before = robot.ids()
    assert robot.swap("one", verb="stop").returncode == 0
    assert robot.containers() == {"node": "one exited"}
    assert robot.swap("one", verb="start").returncode == 0
    assert robot.swap("one", verb="restart").returncode == 0
    assert robot.containers() == {"node": "one running"}
    assert robot.ids() == before
    assert [line[0] for line in robot.told()] == ["ship", "stop", "start", "restart"]


# --- The robot's own data: (delivered before, on the robot now, new), and what is there afterwards.


@pytest.mark.parametrize("conflict", ["robot", "desktop"])
@pytest.mark.parametrize(
    ("old", "now", "new", "for_robot", "for_desktop"),
    [
        pytest.param("a", "a", "a", {"f": "a"}, {"f": "a"}, id="nobody changed it"),
        pytest.param("a", "a", "b", {"f": "b"}, {"f": "b"}, id="the desktop changed it"),
        pytest.param("a", "r", "a", {"f": "r"}, {"f": "r"}, id="the robot changed it"),
        pytest.param("a", "b", "b", {"f": "b"}, {"f": "b"}, id="both changed it alike"),
        pytest.param(
            "a", "r", "b", {"f": "r", "f.from-desktop": "b"}, {"f": "b", "f.from-robot": "r"}, id="both changed it"
        ),
        pytest.param("a", None, "a", {}, {}, id="the robot removed it"),
        pytest.param("a", None, "b", {}, {"f": "b"}, id="removed and changed"),
        pytest.param(None, "r", "b", {"f": "r", "f.from-desktop": "b"}, {"f": "b", "f.from-robot": "r"}, id="it was the robot's first"),
        pytest.param(None, None, "b", {"f": "b"}, {"f": "b"}, id="new"),
        pytest.param("a", "a", None, {"f": "a"}, {"f": "a"}, id="not delivered any more"),
        pytest.param("a", "r", None, {"f": "r"}, {"f": "r"}, id="changed, and not delivered any more"),
    ],
)  # fmt: skip
def test_files_are_merged_as_dpkg_merges_them(
    robot: Robot,
    old: str | None,
    now: str | None,
    new: str | None,
    for_robot: dict[str, str],
    for_desktop: dict[str, str],
    conflict: str,
) -> None:
    """What the robot has changed is kept, unless the desktop is to win; then the robot's is laid beside."""
    robot.release("one", seeds={} if old is None else {"d/f": old})
    robot.release("two", seeds={} if new is None else {"d/f": new})
    assert robot.swap("one", settle=0).returncode == 0
    here = robot.data / "d/f"
    here.parent.mkdir(exist_ok=True, parents=True)
    if now is None:
        here.unlink(missing_ok=True)
    else:
        here.write_text(now)
    done = robot.swap("two", conflict=conflict, settle=0)
    assert done.returncode == 0
    there = {path.name: path.read_text() for path in here.parent.iterdir()}
    assert there == (for_robot if conflict == "robot" else for_desktop)
    said = {
        "f.from-desktop": "note: d/f was changed on the robot too: kept, the new one is d/f.from-desktop\n",
        "f.from-robot": "note: d/f was changed on the robot too: replaced, the robot's is d/f.from-robot\n",
    }
    assert done.stdout == "".join(said.get(name, "") for name in sorted(there))


def test_a_conflict_is_told_once(robot: Robot) -> None:
    """The next release with the same file leaves the robot's as it is, without a word."""
    for name, text in (("one", "a"), ("two", "b"), ("three", "b")):
        robot.release(name, seeds={"f": text})
    robot.swap("one", settle=0)
    (robot.data / "f").write_text("robot")
    assert robot.swap("two", settle=0).stdout != ""
    assert robot.swap("three", settle=0).stdout == ""
    assert (robot.data / "f").read_text() == "robot"


def test_a_decision_later_takes_the_desktops(robot: Robot) -> None:
    """The flag that a person gives after the note has been read replaces the file of the same release."""
    robot.release("one", seeds={"f": "a"})
    robot.release("two", seeds={"f": "b"})
    robot.swap("one", settle=0)
    (robot.data / "f").write_text("robot")
    robot.swap("two", settle=0)
    robot.swap("two", settle=0, conflict="desktop")
    assert (robot.data / "f").read_text() == "b"
    assert (robot.data / "f.from-robot").read_text() == "robot"


def test_a_decision_reaches_a_container_that_runs(robot: Robot) -> None:
    """It has the single file mounted, and would keep the one that was replaced: it is made anew."""
    tune = robot.data / "tune.yaml"
    mount = {"volumes": [f"{tune}:/tune.yaml"]}
    for name, text in (("one", "1"), ("two", "2")):
        robot.release(name, seeds={"tune.yaml": text}, more=mount)
    assert robot.swap("one").returncode == 0
    tune.write_text("robot")
    assert robot.swap("two").returncode == 0
    before = robot.ids()
    assert robot.swap("two").returncode == 0
    assert robot.ids() == before
    assert robot.swap("two", conflict="desktop").returncode == 0
    (container,) = robot.ids()
    inside = subprocess.run(
        ("docker", "exec", container, "cat", "/tune.yaml"), check=True, capture_output=True
    )
    assert (inside.stdout, container in before) == (b"2", False)
    assert robot.swap("two", conflict="desktop").returncode == 0
    assert robot.ids() == [container]


def test_what_cannot_be_recorded_is_not_done(robot: Robot) -> None:
    """A full disk, for example: the release runs, and whoever asked must know that the robot could not write it down."""
    robot.release("one")
    (robot.folder / "history.new").mkdir()
    done = robot.swap("one")
    assert (done.returncode, "release one runs, and this cannot be recorded" in done.stderr) == (1, True)
    assert (robot.folder / "journal").exists()
    (robot.folder / "history.new").rmdir()
    assert robot.swap("one").returncode == 0
    assert not (robot.folder / "journal").exists()


def test_modes_links_and_odd_names(robot: Robot) -> None:
    """A seed keeps its executable bit, a link stays one, and names may hold anything but a line's end."""
    robot.release("one", seeds={"a 'b' $c\\d*": "x", "run.sh": "#!"})
    seeds = robot.folder / "releases/one/seeds"
    (seeds / "run.sh").chmod(0o755)
    (seeds / "link").symlink_to("run.sh")
    robot.swap("one", settle=0)
    assert (robot.data / "a 'b' $c\\d*").read_text() == "x"
    assert (robot.data / "run.sh").stat().st_mode & 0o777 == 0o755
    assert (robot.data / "link").readlink() == Path("run.sh")
    before = (robot.folder / "delivered").read_text()
    assert robot.swap("one", settle=0).stdout == ""
    assert (robot.folder / "delivered").read_text() == before


def test_a_folder_where_a_file_is_delivered(robot: Robot) -> None:
    """What the robot has there is not removed."""
    robot.release("one", seeds={"f": "a"})
    (robot.data / "f").mkdir(parents=True)
    (robot.data / "f/own").write_text("mine")
    done = robot.swap("one", settle=0)
    assert done.returncode == 0
    assert (robot.data / "f/own").read_text() == "mine"
    assert (robot.data / "f.from-desktop").read_text() == "a"


@pytest.mark.parametrize("owner", [0, 1000, 54321])
def test_data_of_a_container_survives_everything(robot: Robot, owner: int) -> None:
    """Whoever owns it: a second ship, a new release that crashes, and the way back leave it alone."""
    mount = {"volumes": [f"{robot.data}/maps:/maps"]}
    write = f"[ -e /maps/house ] || echo walls > /maps/house; chown -R {owner}:{owner} /maps; "
    robot.release("one", write + STAYS, folders="maps\n", more=mount)
    robot.release("two", "exit 1", folders="maps\n", more=mount)
    for release, code in (("one", 0), ("one", 0), ("two", 1)):
        assert robot.swap(release, settle=3).returncode == code
        assert (robot.data / "maps/house").read_text() == "walls\n"
        assert (robot.data / "maps/house").stat().st_uid == owner


def test_a_warning_of_compose_is_not_the_reason(robot: Robot) -> None:
    """What stands in the table of all robots is the error."""
    robot.release("aaa", more={"devices": ["/dev/nowhere"]})
    path = robot.folder / "releases/aaa/compose.yaml"
    path.write_text(json.dumps({"version": "3", **json.loads(path.read_text())}))
    done = robot.swap("aaa")
    assert done.returncode == 1
    assert done.stderr.startswith("Error response from daemon: error gathering device information")
    assert "obsolete" not in done.stderr


def test_a_data_folder_that_cannot_be_made(robot: Robot) -> None:
    """Why is said, the one before runs on, and nothing was removed."""
    robot.release("one")
    robot.release("two", folders="maps/deep\n")
    robot.swap("one")
    before = robot.ids()
    (robot.data / "maps").write_text("a file in the way")
    done = robot.swap("two")
    assert done.returncode == 1
    assert "the robot's data cannot be written: mkdir: " in done.stderr
    assert robot.containers() == {"node": "one running"}
    assert robot.ids() == before
    assert (robot.data / "maps").read_text() == "a file in the way"


def test_it_starts_from_anywhere_and_reads_no_variables(robot: Robot) -> None:
    """The login's own COMPOSE_* variables choose no other files, services or project."""
    robot.release("one")
    environment = {
        **robot.environment,
        "COMPOSE_FILE": "/nope.yaml",
        "COMPOSE_PROFILES": "x",
        "COMPOSE_PROJECT_NAME": "other",
    }
    done = subprocess.run(robot.argv("one"), env=environment, cwd="/", check=False, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
    assert robot.containers() == {"node": "one running"}


def test_folders_of_data_come_with_their_modes(robot: Robot) -> None:
    """Empty ones too; one that is there stays as it is, and one that the robot has removed stays removed."""
    folders = {"logs/": "777", "logs/deep/": "700", "logs/gone/": "755"}
    robot.release("one", seeds=folders)
    robot.release("two", seeds=folders, more={"environment": {"X": "2"}})
    assert robot.swap("one").returncode == 0
    logs = robot.data / "logs"
    assert [oct((logs / name).stat().st_mode & 0o777) for name in (".", "deep", "gone")] == ["0o777", "0o700", "0o755"]  # fmt: skip
    (logs / "deep").chmod(0o711)
    (logs / "gone").rmdir()
    assert robot.swap("two").returncode == 0
    assert (oct((logs / "deep").stat().st_mode & 0o777), (logs / "gone").exists()) == ("0o711", False)


def test_a_file_becomes_a_folder_and_a_folder_a_file(robot: Robot) -> None:
    """The robot's own files stay, whatever the project makes of their place."""
    robot.release("one", seeds={"a": "file", "b/": "755", "b/x": "x", "c": "file"})
    robot.release("two", seeds={"a/": "755", "a/x": "new", "b": "file", "c/": "755", "c/x": "new"})
    assert robot.swap("one").returncode == 0
    (robot.data / "b/own").write_text("own")
    (robot.data / "c").write_text("own")
    done = robot.swap("two")
    assert done.returncode == 0, done.stderr
    assert (robot.data / "a/x").read_text() == "new"
    assert (robot.data / "b").read_text() == "file"
    assert {path.name for path in (robot.data / "b.from-robot").iterdir()} == {"x", "own"}
    assert (robot.data / "c").read_text() == "own"
    assert "note: c was changed on the robot too: kept, the new one is c.from-desktop" in done.stdout


@pytest.mark.parametrize("jump", ["+3 years", "-3 years"])
def test_the_clock_jumps_in_a_swap(robot: Robot, jump: str) -> None:
    """As on a robot without a battery that finds a time server: the release is neither too late nor watched for ever."""
    date = robot.home.parent / "bin/date"
    date.write_text(
        f'#!/bin/sh\n[ -e {date}.once ] && exec {shutil.which("date")} -d \'{jump}\' "$@"\n: >{date}.once\nexec {shutil.which("date")} "$@"\n'
    )
    date.chmod(0o755)
    robot.release("one")
    began = time.monotonic()
    done = robot.swap("one", settle=2)
    assert (done.returncode, done.stderr) == (0, "")
    assert 2 <= time.monotonic() - began < 40


def test_a_folder_that_a_container_has_closed(robot: Robot) -> None:
    """What is in it was not removed, it is out of sight: a changed file cannot be laid there, and that is said."""
    if os.geteuid() == 0:
        pytest.skip("root sees all")
    robot.release("one", seeds={"cfg/tune.yaml": "1"})
    robot.release("two", seeds={"cfg/tune.yaml": "2"})
    assert robot.swap("one").returncode == 0
    (robot.data / "cfg").chmod(0)
    again, other = robot.swap("one"), robot.swap("two")
    (robot.data / "cfg").chmod(0o755)
    assert (again.returncode, other.returncode) == (0, 1)
    what = (
        f"the robot's data cannot be written: cannot reach '{robot.data}/cfg/tune.yaml': Permission denied\n"
    )
    assert other.stderr.startswith(what)
    assert robot.containers() == {"node": "one running"}
