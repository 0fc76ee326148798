from __future__ import annotations

import getpass
import os
import resource
import shutil
import subprocess
import time
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.images import identity
from fleet.robot.facts import Container, Facts
from fleet.robot.probe import MARK, parse, probe

if TYPE_CHECKING:
    from pathlib import Path

SHELLS = [shell for shell in ("dash", "bash", "busybox") if shutil.which(shell)]


def probed(home: Path, shell: str = "sh", path: str = "") -> str:
    """What the probe says on this computer, run as SSH would run it on a robot."""
    argv = (shell, "sh") if shell == "busybox" else (shell,)
    environment = {"HOME": str(home), "PATH": path or os.environ["PATH"]}
    return subprocess.run(
        (*argv, "-c", probe(images=True)),
        env=environment,
        cwd=home,
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def answer(**sections: str) -> str:
    """A probe's answer with only these sections."""
    return "".join(f"\n{MARK} {name}\n{body}\n" for name, body in {**sections, "end": ""}.items())


@pytest.fixture
def bare_path(tmp_path: Path) -> Path:
    """A PATH with the programs of a small system, and neither docker nor sudo; tests add their own."""
    path = tmp_path / "bin"
    path.mkdir()
    for name in (
        "uname",
        "id",
        "date",
        "df",
        "cat",
        "ls",
        "tail",
        "sed",
        "grep",
        "readlink",
        "getent",
        "dpkg",
    ):
        if found := shutil.which(name):
            (path / name).symlink_to(found)
    return path


def program(folder: Path, name: str, script: str) -> None:
    """A program that says what a robot's would."""
    (folder / name).write_text(f"#!/bin/sh\n{script}\n")
    (folder / name).chmod(0o755)


@pytest.mark.parametrize("shell", SHELLS)
def test_the_probe_runs_in_the_shells_of_robots(shell: str, tmp_path: Path) -> None:
    """What it says of this computer is what Python says of it."""
    seen = parse(probed(tmp_path, shell))
    usage = shutil.disk_usage("/var/lib")
    assert seen.machine == os.uname().machine
    assert seen.login == getpass.getuser()
    assert seen.sudo == "root" if os.geteuid() == 0 else seen.sudo in ("free", "password", "none")
    assert seen.groups
    assert abs(seen.clock - time.time()) < 60
    assert seen.disk_size == pytest.approx(usage.total, rel=0.1)
    assert seen.platforms[0] in ("linux/amd64", "linux/arm64", "linux/arm/v7")
    assert seen.current == ""
    assert seen.releases == ()
    assert seen.noise == ""


def test_the_probe_sees_what_fleet_keeps_there(tmp_path: Path) -> None:
    """The current release, those that are there (not one that is half written), and the history's lines."""
    for name in ("aaa", "bbb", "ccc.part"):
        (tmp_path / ".fleet/releases" / name).mkdir(parents=True)
    (tmp_path / ".fleet/current").symlink_to("releases/bbb")
    (tmp_path / ".fleet/history").write_text("".join(f"line {number}\n" for number in range(300)))
    seen = parse(probed(tmp_path))
    assert (seen.current, seen.releases) == ("bbb", ("aaa", "bbb"))
    assert len(seen.history) == 200
    assert seen.history[-1] == "line 299"


def test_the_probe_looks_and_never_touches(tmp_path: Path) -> None:
    """Not a file, not a time stamp changes in the login's home."""
    (tmp_path / ".fleet/releases/aaa").mkdir(parents=True)
    (tmp_path / ".fleet/history").write_text("one\n")

    def state() -> dict[str, tuple[int, int]]:
        return {str(p): (p.stat().st_mtime_ns, p.stat().st_size) for p in (tmp_path, *tmp_path.rglob("*"))}

    before = state()
    probed(tmp_path)
    assert state() == before


def test_the_probe_is_quick(tmp_path: Path) -> None:
    """`fab status` is one probe: it costs less than a second of a processor, also here beside other work."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    costs = []
    for _ in range(3):
        before = spent()
        probed(tmp_path)
        costs.append(spent() - before)
    assert min(costs) < 1.0


def test_a_robot_without_docker_and_sudo(tmp_path: Path, bare_path: Path) -> None:
    """Programs that are not there leave their facts empty; the answer still has its end."""
    said = probed(tmp_path, "/bin/sh", path=str(bare_path))
    seen = parse(said)
    assert f"{MARK} end" in said
    assert (seen.engine, seen.docker, seen.client, seen.compose) == ("absent", "", "", "")
    assert seen.sudo in ("root", "none")


@pytest.mark.parametrize(
    ("script", "engine", "version"),
    [
        ("echo 28.0.4", "ready", "28.0.4"),
        ("echo 20.10.24+dfsg1", "ready", "20.10.24+dfsg1"),
        (
            "echo 'WARNING: open /home/pi/.docker/config.json: permission denied' >&2; echo 28.0.4",
            "ready",
            "28.0.4",
        ),
        (
            "echo 'permission denied while trying to connect to the Docker daemon socket' >&2; exit 1",
            "forbidden",
            "",
        ),
        (
            "echo 'Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is it running?' >&2; exit 1",
            "stopped",
            "",
        ),
        ("exit 1", "stopped", ""),
    ],
)
def test_an_engine_is_known_by_what_its_client_says(
    tmp_path: Path, bare_path: Path, script: str, engine: str, version: str
) -> None:
    """The client writes its reasons to standard error, and warnings before its answer."""
    program(bare_path, "docker", f'[ "$1" = version ] || exit 1\n{script}')
    seen = parse(probed(tmp_path, "/bin/sh", path=str(bare_path)))
    assert (seen.engine, seen.docker) == (engine, version)


def test_a_client_without_the_compose_plugin_has_no_compose() -> None:
    """Old clients answer an unknown command with their help, on standard output."""
    assert (
        parse(answer(docker="20.10.24", compose="Usage:  docker [OPTIONS] COMMAND\n\nA runtime")).compose
        == ""
    )
    assert parse(answer(docker="28.0.4", compose="v2.34.0")).compose == "2.34.0"
    assert parse(answer(docker="28.0.4", compose="2.26.1-4")).compose == "2.26.1-4"


def test_the_whole_answer_of_a_pi() -> None:
    """Every section ends in the fact of its name."""
    said = answer(
        machine="aarch64",
        userland="arm64",
        os="Debian GNU/Linux 13 (trixie)",
        login="pi\npi sudo docker",
        sudo="password",
        clock="1790000000",
        disk="Filesystem 1024-blocks Used Available Capacity Mounted on\n/dev/root 30000000 20000000 10000000 67% /",
        temperature="54321",
        emulates="/proc/sys/fs/binfmt_misc/qemu-arm",
        boot="enabled",
        daemon='{\n  "log-driver": "json-file"\n}',
        packages="docker-ce\ndocker-buildx",
        interrupted="Status: install ok half-configured",
        source="/etc/apt/sources.list.d/docker.list",
        group="docker:x:996:pi,tim",
        current="releases/abc",
        releases="abc\ndef",
        history="one\ttwo",
        docker="28.0.4",
        client="Docker version 28.0.4, build b8034c0",
        store="/var/lib/docker overlay2 extfs true",
        compose="2.34.0",
        images="image talker:fleet-1\nlinux/arm64\nlayer sha256:aa\nuser \ndirectory \nimage b:fleet-2\nlinux/arm64\ndirectory",
    )
    assert parse(said) == Facts(
        machine="aarch64",
        userland="arm64",
        os="Debian GNU/Linux 13 (trixie)",
        login="pi",
        groups=("pi", "sudo", "docker"),
        sudo="password",
        clock=1790000000.0,
        disk_size=30_720_000_000,
        disk_free=10_240_000_000,
        temperature=54.321,
        emulates=("qemu-arm",),
        starts_at_boot=True,
        daemon_config='{\n  "log-driver": "json-file"\n}',
        docker_group=("pi", "tim"),
        packages=("docker-ce", "docker-buildx"),
        interrupted=True,
        docker_source=True,
        current="abc",
        releases=("abc", "def"),
        history=("one\ttwo",),
        engine="ready",
        docker="28.0.4",
        client="28.0.4",
        store="overlay2",
        compose="2.34.0",
        images={
            "talker:fleet-1": "linux/arm64\nlayer sha256:aa\nuser \ndirectory",
            "b:fleet-2": "linux/arm64\ndirectory",
        },
    )


def test_what_a_login_script_prints_is_noise_and_not_an_answer() -> None:
    """It would corrupt streams, so it is kept to be complained about; no fact comes from it."""
    seen = parse("Welcome to pi1!\nroot\n" + answer(machine="aarch64", login="pi\npi"))
    assert seen.noise == "Welcome to pi1!\nroot"
    assert (seen.machine, seen.login) == ("aarch64", "pi")


def test_sections_that_are_missing_leave_the_defaults() -> None:
    """An old or odd robot answers less; nothing is made up."""
    assert parse(answer()) == Facts()
    assert parse("") == Facts()


@given(
    st.dictionaries(
        st.sampled_from(probe(images=True).split("section ")[1:]).map(lambda s: s.split(";")[0].split()[0]),
        st.text(),
    )
)
def test_garbage_in_any_section_is_no_traceback(sections: dict[str, str]) -> None:
    """A robot may print anything; what cannot be read is a fact that is not there."""
    parse(answer(**sections))


@pytest.mark.parametrize(
    ("said", "members"), [("", None), ("docker:x:996:", ()), ("docker:x:996:pi", ("pi",))]
)
def test_no_docker_group_is_another_thing_than_an_empty_one(
    said: str, members: tuple[str, ...] | None
) -> None:
    """Without Docker's package there is no group to put the login into."""
    assert parse(answer(group=said)).docker_group == members


def test_containers_say_their_service_release_and_state() -> None:
    """From Docker's own JSON lines; a label may hold commas, and warnings may stand between."""
    line = (
        '{"Names":"talker-talker-1","State":"running","Status":"Up 3 minutes (healthy)",'
        '"Labels":"com.docker.compose.depends_on=a:service_started:false,b:service_healthy:true,'
        'com.docker.compose.service=talker,fleet.release=abc"}'
    )
    assert parse(answer(docker="28.0.4", containers=f"WARNING: no swap limit\n{line}")).containers == (
        Container(
            name="talker-talker-1",
            service="talker",
            release="abc",
            stack="",
            state="running",
            status="Up 3 minutes (healthy)",
        ),
    )


@pytest.mark.parametrize(
    ("state", "status", "healthy"),
    [
        ("running", "Up 3 minutes (healthy)", True),
        ("running", "Up 3 minutes", True),
        ("running", "Up 3 minutes (unhealthy)", False),
        ("running", "Up 3 seconds (health: starting)", False),
        ("exited", "Exited (0) 3 seconds ago", False),
        ("restarting", "Restarting (1) 3 seconds ago", False),
    ],
)
def test_healthy_is_running_and_not_said_to_be_otherwise(state: str, status: str, healthy: bool) -> None:
    """A container without a healthcheck that runs is as well as it can say."""
    assert Container(name="", service="", release="", stack="", state=state, status=status).healthy is healthy


@pytest.mark.parametrize(
    ("machine", "userland", "emulates", "platforms"),
    [
        ("aarch64", "arm64", (), ("linux/arm64",)),
        ("aarch64", "armhf", (), ("linux/arm/v7",)),
        ("armv7l", "armhf", (), ("linux/arm/v7",)),
        ("armv6l", "armhf", (), ()),
        ("aarch64", "", (), ("linux/arm64",)),
        ("aarch64", "64", (), ("linux/arm64",)),
        (
            "x86_64",
            "amd64",
            ("qemu-aarch64", "qemu-arm", "qemu-riscv64"),
            ("linux/amd64", "linux/arm64", "linux/arm/v7"),
        ),
        ("aarch64", "arm64", ("qemu-aarch64",), ("linux/arm64",)),
        ("riscv64", "riscv64", (), ()),
    ],
)
def test_platforms_are_those_of_the_userland_then_the_emulated(
    machine: str, userland: str, emulates: tuple[str, ...], platforms: tuple[str, ...]
) -> None:
    """A 64-bit kernel under a 32-bit system (Raspberry Pi OS on a Pi 4) runs 32-bit containers."""
    assert Facts(machine=machine, userland=userland, emulates=emulates).platforms == platforms


def test_the_identity_of_images_is_asked_for_as_docker_takes_it() -> None:
    """It goes through ``sh`` in single quotes, so it may have none of its own."""
    assert "'" not in identity.IDENTITY
    assert identity.IDENTITY in probe()


@pytest.mark.parametrize(
    ("said", "root", "store", "containerd"),
    [
        ("/var/lib/docker overlay2 extfs true", "/var/lib/docker", "overlay2", False),
        ("/ssd/docker overlay2", "/ssd/docker", "overlay2", False),
        ("/var/lib/docker overlayfs io.containerd.snapshotter.v1", "/var/lib/docker", "overlayfs", True),
        ("", "/var/lib/docker", "", False),
        (" overlay2 x", "/var/lib/docker", "", False),
    ],
)
def test_where_and_how_docker_keeps_images(said: str, root: str, store: str, containerd: bool) -> None:
    """On Jetsons the data are often on another disk; which store it is decides what may be left out."""
    seen = parse(f"\n{MARK} store\n{said}\n{MARK} end\n")
    assert (seen.data_root, seen.store, seen.containerd) == (root, store, containerd)
