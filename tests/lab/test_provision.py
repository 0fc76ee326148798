from __future__ import annotations

import json
import subprocess
import time
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from fleet.config import inventory
from fleet.errors import NotReady
from fleet.lab import lifecycle
from fleet.plan.step import Bytes
from fleet.provision import apt, docker_script
from fleet.provision import steps as provision
from fleet.rollout.apply import apply
from fleet.rollout.link import Link
from fleet.ssh import connect, known_hosts
from tests.support.lab_project import LAB

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.plan.outcome import Outcome
    from fleet.plan.step import Feed, Plan
    from fleet.robot.facts import Facts

BOUNDS = apt.Bounds(lock_timeout=120, limit=300)


class Ear:
    """Watches a rollout, and remembers which steps began."""

    def __init__(self) -> None:
        self.steps: list[str] = []

    def announce(self, robots: Sequence[str], title: str) -> None:
        pass

    def step_started(self, robot: str, title: str, size: int | None) -> None:  # noqa: ARG002
        self.steps.append(title)

    def bytes_sent(self, robot: str, count: int) -> None:
        pass

    def note(self, robot: str, text: str) -> None:
        pass

    def finished(self, outcome: Outcome) -> None:
        pass


def opened(feed: Feed) -> Iterable[bytes]:
    assert isinstance(feed, Bytes)
    return (feed.data,)


@dataclass(frozen=True, kw_only=True)
class Target:
    """One virtual Pi: as the inventory's robot, and as the container that a test breaks things in."""

    robot: Robot
    container: str
    script: bytes

    def root(self, command: str, *, timeout: float = 300) -> str:
        """Run as root, past SSH; the output."""
        argv = ("docker", "exec", self.container, "sh", "-c", command)
        done = subprocess.run(argv, capture_output=True, text=True, timeout=timeout, check=False)
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        return done.stdout.strip()

    @contextmanager
    def broken(self, command: str, *, mended_by: str) -> Iterator[None]:
        """With something broken, and whole again afterwards."""
        self.root(command)
        try:
            yield
        finally:
            self.root(mended_by)

    def facts(self) -> Facts:
        link = Link(self.robot)
        try:
            return link.facts()
        finally:
            link.close()

    def plan(self, script: bytes = b"", *, bounds: apt.Bounds = BOUNDS) -> Plan:
        script = script or self.script
        facts = self.facts()
        return provision.plan(
            robot=self.robot,
            facts=facts,
            script=script,
            now=time.time(),
            by="tim@desktop",
            bounds=bounds,
        )

    def provision(self, script: bytes = b"", *, bounds: apt.Bounds = BOUNDS) -> tuple[Outcome, list[str]]:
        """What became of it, and the steps that began."""
        ear, link = Ear(), Link(self.robot)
        try:
            return apply(self.plan(script, bounds=bounds), link, open_feed=opened, progress=ear), ear.steps
        finally:
            link.close()


def made(name: str, directory: Path) -> Iterator[Target]:
    lifecycle.down(directory=directory, name=name, say=print)  # what a killed run left
    lifecycle.up(1, directory=directory, name=name, say=print)
    (robot,) = inventory.load(directory / "inventory.yaml").robots.values()
    (pi,) = lifecycle.list_(name=name)
    known_as, key = connect.offered_key(robot)
    known_hosts.record(robot.known_hosts, name=known_as, key=key)
    source = docker_script.fetch(robot.docker.script, sha256=None, base=directory)
    yield Target(robot=robot, container=pi.container, script=source)
    lifecycle.down(directory=directory, name=name, say=print)


@pytest.fixture(scope="module")
def blank(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    """A Pi that every test leaves without Docker."""
    yield from made(f"{LAB}-blank", tmp_path_factory.mktemp("blank"))


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    """A Pi that was provisioned once, and that every test leaves ready."""
    for target in made(f"{LAB}-ready", tmp_path_factory.mktemp("ready")):
        outcome, _ = target.provision()
        assert outcome.status == "done", outcome
        yield target


def mended(target: Target) -> list[str]:
    """Provision what was broken: the steps, and the second plan has none."""
    outcome, steps = target.provision()
    assert outcome.status == "done", outcome
    assert target.plan().steps == ()
    return steps[: steps.index("prove that Docker answers this login")]


def test_sudo_with_a_password_is_refused(blank: Target) -> None:
    """With the line that cures it; nothing was touched."""
    rule = "/etc/sudoers.d/010_pi-nopasswd"
    with (
        blank.broken(f"mv {rule} /root/rule", mended_by=f"mv /root/rule {rule}"),
        pytest.raises(NotReady, match=r"sudo asks pi for a password.*: pi ALL=\(ALL\) NOPASSWD: ALL"),
    ):
        blank.plan()
    assert blank.plan().steps


def test_little_space_is_refused(blank: Target) -> None:
    """Docker's own partition counts, where it has one."""
    with (
        blank.broken("mount -t tmpfs -o size=100m tmpfs /var/lib/docker", mended_by="umount /var/lib/docker"),
        pytest.raises(NotReady, match=r"it needs 1\.0 GB of free disk, and has 105 MB"),
    ):
        blank.plan()


def test_a_disk_that_fills_is_told(blank: Target) -> None:
    """The root file system had room, and apt's cache has not."""
    cache = "/var/cache/apt/archives"
    with blank.broken(f"mount -t tmpfs -o size=100k tmpfs {cache}", mended_by=f"umount {cache}"):
        outcome, _ = blank.provision()
    assert (outcome.status, outcome.step) == ("failed", "install Docker, which takes minutes")
    assert outcome.reason.startswith("the robot's disk is full")
    assert "apt-get clean" in outcome.cure


def test_no_network_is_told(blank: Target) -> None:
    """A robot that has neither internet nor the packages."""
    cache = "/var/cache/apt/archives"
    with (
        blank.broken(f"mount -t tmpfs tmpfs {cache}", mended_by=f"umount {cache}"),
        blank.broken(
            "ip route show default > /root/route; ip route del default",
            mended_by="ip route add $(cat /root/route)",
        ),
    ):
        outcome, _ = blank.provision()
    assert outcome.status == "failed"
    assert outcome.reason.startswith(("the robot cannot resolve deb.debian.org", "the robot cannot reach"))
    assert "internet" in outcome.cure


def test_a_script_that_does_nothing_is_not_believed(blank: Target) -> None:
    """Its exit code of 0 proves nothing; it stays there to be looked at."""
    outcome, _ = blank.provision(b"#!/bin/sh\nexit 0\n")
    assert (outcome.status, outcome.step) == ("failed", "prove that the script installed Docker")
    assert outcome.reason.startswith("the script ended without an error, and did not install Docker")
    assert outcome.cure == "`sudo sh -x .fleet/get-docker.sh` on the robot shows what the script does"
    assert blank.root("cat /home/pi/.fleet/get-docker.sh") == "#!/bin/sh\nexit 0"


def test_a_script_that_hangs_is_ended_on_the_robot(blank: Target) -> None:
    """With all that it started, though that is root's."""
    hangs = b"#!/bin/sh\ntrap '' TERM\necho begun\nsleep 4321 &\nwhile :; do sleep 4321; done\n"
    started = time.monotonic()
    outcome, _ = blank.provision(hangs, bounds=apt.Bounds(lock_timeout=1, limit=2))
    assert outcome.status == "failed"
    assert outcome.reason.startswith("the command did not end within 2 s, and was stopped")
    assert time.monotonic() - started < 30
    assert blank.root("pgrep -fc '[s]leep 4321' || true") == "0"


def test_a_package_source_that_poisons_apt_is_taken_back(blank: Target) -> None:
    """A script that fails half-way leaves one, and every apt-get update after it fails."""
    poison = (
        b"#!/bin/sh\nset -e\necho 'deb http://deb.debian.org/debian nosuchsuite main' "
        b"> /etc/apt/sources.list.d/docker.list\napt-get -qq update >/dev/null\n"
    )
    outcome, _ = blank.provision(poison)
    assert outcome.reason.startswith("apt rejects the package source http://deb.debian.org/debian nosuch")
    assert "went back: remove Docker's package source" in outcome.reason
    assert "docker.list" not in blank.root("ls /etc/apt/sources.list.d; apt-get -qq update")


def test_an_apt_that_stays_locked_is_told(blank: Target) -> None:
    """By whom, and that waiting helps; the waiting has an end."""
    hold = (
        "import fcntl, pathlib, time\n"
        "lock = open('/var/lib/apt/lists/lock', 'w')\n"
        "fcntl.lockf(lock, fcntl.LOCK_EX)\n"
        "pathlib.Path('/root/held').touch()\n"
        "while pathlib.Path('/root/held').exists(): time.sleep(0.05)\n"
    )
    blank.root(f'python3 -c "{hold}" > /dev/null 2>&1 & until [ -e /root/held ]; do sleep 0.05; done')
    with blank.broken("true", mended_by="rm /root/held"):
        outcome, _ = blank.provision(bounds=apt.Bounds(lock_timeout=1, limit=60))
    assert outcome.status == "failed"
    assert outcome.reason.startswith("another program on the robot uses apt (python3)")
    assert "wait until it has finished" in outcome.cure


def test_a_bad_morning_ends_well(tmp_path: Path) -> None:
    """A first boot: dpkg cut off by a power cut, Debian's buildx, a poisoned source, and updates that hold every lock."""
    hold = (
        "import fcntl, pathlib, subprocess as s, time\n"
        "locks = [open('/var/lib/' + name, 'w') for name in ('apt/lists/lock', 'dpkg/lock-frontend')]\n"
        "for lock in locks: fcntl.lockf(lock, fcntl.LOCK_EX)\n"
        "pathlib.Path('/root/held').touch()\n"
        "def seen(*argv):\n"
        "    while s.run(argv, capture_output=True).returncode: time.sleep(0.05)\n"
        "seen('sh', '-c', 'grep -qs frontend.lock.was.locked /tmp/tmp.*/output')\n"
        "locks[1].close()\n"
        "seen('sh', '-c', 'grep -qs Could.not.get.lock./var/lib/apt/lists /tmp/tmp.*/output')\n"
        "locks[0].close()\n"
    )
    for target in made(f"{LAB}-morning", tmp_path):
        target.root("apt-get -qq update && apt-get -qq -y install --no-install-recommends docker-buildx 2>&1")
        target.root("touch /var/lib/dpkg/updates/0001")
        target.root(
            "echo 'deb http://deb.debian.org/debian nosuch main' > /etc/apt/sources.list.d/docker.list"
        )
        target.root(f'python3 -c "{hold}" > /dev/null 2>&1 & until [ -e /root/held ]; do sleep 0.05; done')
        steps = [title for title in mended(target) if "trying again" not in title]
        assert steps[:6] == [
            "keep 3 log files of 10m per container",
            "check that the robot reaches its package archive",
            "complete an interrupted installation of packages",
            "remove Docker's package source",
            "remove docker-buildx, which clash with Docker's own packages",
            "send Docker's script " + f"({target.robot.docker.script})",
        ]


def test_a_ready_pi_is_left_alone(ready: Target) -> None:
    """The second run has nothing to do, says what is there, and changes nothing."""
    plan = ready.plan()
    assert plan.steps == ()
    assert plan.summary.startswith("Docker 26.")
    outcome, steps = ready.provision()
    assert (outcome.status, steps) == ("unchanged", [])


def test_nothing_is_left_behind(ready: Target) -> None:
    """Neither the proof's image nor its container nor the script; the history says what was done, by whom."""
    assert ready.root("docker image ls -q; docker ps -aq; ls /home/pi/.fleet") == "history"
    (line, *_) = ready.root("cat /home/pi/.fleet/history").splitlines()
    assert line.split("\t")[1:] == ["provision", "", "tim@desktop", "done"]


def test_log_rotation_was_there_before_docker(ready: Target) -> None:
    """Docker reads it when it starts, and gives it to the containers it creates."""
    ready.root("tar -c -C / etc/hostname | docker import - logged && docker create --name logged logged x")
    said = ready.root("docker inspect --format '{{json .HostConfig.LogConfig}}' logged")
    ready.root("docker rm logged && docker image rm logged")
    assert json.loads(said) == {"Type": "json-file", "Config": {"max-file": "3", "max-size": "10m"}}


def test_docker_that_is_off_is_started_and_stays_on(ready: Target) -> None:
    """At every boot too."""
    ready.root("systemctl disable --now docker.service docker.socket")
    assert ready.facts().docker.state == "stopped"
    assert mended(ready) == ["start Docker now and at every boot"]
    assert ready.root("systemctl is-active docker; systemctl is-enabled docker") == "active\nenabled"


def test_a_login_outside_the_group_gets_in(ready: Target) -> None:
    """Group membership is read at login: the proof runs on a new one."""
    ready.root("gpasswd --delete pi docker")
    assert ready.facts().docker.state == "forbidden"
    assert mended(ready) == ["let pi use Docker", "start Docker now and at every boot"]


def test_a_missing_compose_plugin_is_added(ready: Target) -> None:
    """From wherever this Docker came; the engine goes on running."""
    engine = ready.root("systemctl show --property MainPID docker")
    ready.root("apt-get -qq -y remove docker-compose")
    assert ready.facts().docker.compose == ""
    assert mended(ready)[-1] == "install Docker's Compose plugin"
    assert ready.root("systemctl show --property MainPID docker") == engine


def test_an_installation_that_was_cut_off_is_finished(ready: Target) -> None:
    """The power went while dpkg had unpacked Docker and not yet set it up."""
    ready.root(
        "systemctl stop docker docker.socket; dpkg --unpack /var/cache/apt/archives/docker.io_*.deb 2>&1"
    )
    assert ready.facts().packages.interrupted
    assert mended(ready) == [
        "complete an interrupted installation of packages",
        "start Docker now and at every boot",
    ]


def test_settings_that_are_not_json_are_refused(ready: Target) -> None:
    """Somebody's work is not thrown away."""
    path = "/etc/docker/daemon.json"
    with (
        ready.broken(f"cp {path} /root/keep; echo '{{ bad' > {path}", mended_by=f"mv /root/keep {path}"),
        pytest.raises(NotReady, match=f"{path} is not JSON: .*line 1.*; fix the file"),
    ):
        ready.plan()


def test_settings_that_only_root_may_read_are_kept(ready: Target) -> None:
    """Docker that runs is not restarted for new settings: its containers go on."""
    path = "/etc/docker/daemon.json"
    engine = ready.root("systemctl show --property MainPID docker")
    ready.root(f"echo '{{\"mtu\": 1400}}' > {path} && chmod 600 {path}")
    assert mended(ready) == ["keep 3 log files of 10m per container, from the next start of Docker on"]
    assert json.loads(ready.root(f"cat {path}"))["mtu"] == 1400
    assert ready.root(f"stat -c %a {path}") == "600"
    assert ready.root("systemctl show --property MainPID docker") == engine


def test_a_docker_that_does_not_start_says_why(ready: Target) -> None:
    """systemctl only says that it failed; the journal has the reason."""
    path = "/etc/docker/daemon.json"
    with ready.broken(
        f"cp {path} /root/keep; sed -i '1a \"nosuch\": 1,' {path}; systemctl stop docker docker.socket",
        mended_by=f"mv /root/keep {path}; systemctl reset-failed docker; systemctl start docker",
    ):
        outcome, _ = ready.provision()
    assert outcome.reason.startswith("Docker does not start")
    assert "directives don't match any configuration option: nosuch" in outcome.reason
    assert ready.plan().steps == ()
