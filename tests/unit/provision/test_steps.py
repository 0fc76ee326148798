from __future__ import annotations

import hashlib
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.config.hardware import Hardware
from fleet.config.inventory import Docker, Robot
from fleet.errors import NotReady
from fleet.plan.describe import lines
from fleet.plan.step import Bytes, Record
from fleet.provision import apt, steps
from fleet.robot.facts import Disk, Facts, Host, Login
from tests.support.samples import change

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.plan.step import Plan, Step

NOW = 1_800_000_000.0
FINISH = "let the robot finish a swap after a power cut (fleet-finish.service)"
SCRIPT = b"#!/bin/sh\necho hello\n"
ROTATES = '{"log-driver": "json-file", "log-opts": {"max-size": "10m", "max-file": "3"}}'

BLANK = Facts(
    host=Host(machine="aarch64", userland="arm64", os="Debian GNU/Linux 13 (trixie)", clock=NOW - 2),
    login=Login(name="pi", groups=("pi", "sudo"), sudo="free"),
    disk=Disk(size=32_000_000_000, free=20_000_000_000),
)
READY = change(
    BLANK,
    groups=("pi", "sudo", "docker"),
    members=("pi",),
    starts_at_boot=True,
    finish_unit=hashlib.sha256(steps.finish_unit("pi").encode()).hexdigest(),
    daemon_config=ROTATES,
    installed=("docker-ce", "zstd"),
    docker_state="ready",
    docker_version="28.1.0",
    client="28.1.0",
    compose="2.35.1",
)


def robot(**docker: str) -> Robot:
    return Robot(name="pi1", address="10.0.0.1", docker=Docker(**docker))  # type: ignore[arg-type]


def planned(facts: Facts, *, of: Robot | None = None) -> Plan:
    return steps.plan(robot=of or robot(), facts=facts, script=SCRIPT, now=NOW, by="tim@desktop")


def titles(plan: Plan) -> list[str]:
    """What is changed: the steps before the proofs."""
    every = [step.title for step in plan.steps]
    return every[: every.index("prove that Docker answers this login")] if every else []


def step(plan: Plan, title: str) -> Step:
    (match,) = (step for step in plan.steps if step.title.startswith(title))
    return match


def test_a_blank_robot_gets_everything_in_a_safe_order() -> None:
    """Log rotation stands before Docker first starts; the proof comes from a new login, last."""
    plan = planned(BLANK)
    assert titles(plan) == [
        "keep 3 log files of 10m per container",
        "check that the robot reaches its package archive",
        "send Docker's script (https://get.docker.com)",
        "install Docker, which takes minutes",
        "prove that the script installed Docker",
        "remove the script",
        "let pi use Docker",
        "start Docker now and at every boot",
        FINISH,
    ]
    proofs = plan.steps[-4:]
    assert [step.fresh_login for step in proofs] == [True, False, False, False]
    assert plan.record == Record(verb="provision", release="", by="tim@desktop")
    assert plan.summary == "Docker installed, ready for pi"


def test_a_ready_robot_is_left_alone() -> None:
    """No steps, and a summary that says why."""
    plan = planned(READY)
    assert (plan.steps, plan.recover, plan.summary) == (
        (),
        (),
        "Docker 28.1.0 with Compose 2.35.1",
    )


def test_a_ready_robot_needs_no_rights() -> None:
    """Nothing is asked of a robot where nothing is to be done."""
    assert planned(change(READY, sudo="password")).steps == ()


@pytest.mark.parametrize(
    ("broken", "cured_by"),
    [
        ({"docker_state": "stopped", "docker_version": ""}, ["start Docker now and at every boot"]),
        (
            {"docker_state": "stopped", "docker_version": "", "interrupted": True},
            ["complete an interrupted installation of packages", "start Docker now and at every boot"],
        ),
        ({"interrupted": True}, []),
        ({"starts_at_boot": False}, ["start Docker now and at every boot"]),
        ({"finish_unit": ""}, [FINISH]),
        ({"finish_unit": "0" * 64}, [FINISH]),
        ({"finish_unit": "no systemd"}, []),
        (
            {"docker_state": "forbidden", "docker_version": "", "groups": ("pi",), "members": ()},
            ["let pi use Docker", "start Docker now and at every boot"],
        ),
        (
            {"compose": ""},
            ["check that the robot reaches its package archive", "install Docker's Compose plugin"],
        ),
        (
            {"compose": "", "interrupted": True},
            [
                "check that the robot reaches its package archive",
                "complete an interrupted installation of packages",
                "install Docker's Compose plugin",
            ],
        ),
        ({"daemon_config": ""}, ["keep 3 log files of 10m per container, from the next start of Docker on"]),
        ({"clock": NOW - 3600}, ["set the clock"]),
    ],
)
def test_only_what_is_wrong_gets_a_step(broken: dict[str, object], cured_by: list[str]) -> None:
    """Docker that is there is never installed again: the script would restart the robot's containers."""
    assert titles(planned(change(READY, **broken))) == cured_by


JETSON: dict[str, object] = {"model": "NVIDIA Jetson Orin Nano", "l4t": "36.4.0", "raw_table": False}


def test_the_newest_docker_is_not_installed_on_a_jetson() -> None:
    """It would not start there; with the line that the refusal names, the right one is installed."""
    with pytest.raises(NotReady, match="no iptables table `raw`") as refused:
        planned(change(BLANK, **JETSON))
    assert refused.value.cure.startswith("write `docker: {version: 27.5.1}` for pi1 in the inventory;")
    with pytest.raises(NotReady):
        planned(change(BLANK, **JETSON), of=robot(version="28.0.1"))
    assert "install Docker 27.5.1, which takes minutes" in titles(
        planned(change(BLANK, **JETSON), of=robot(version="27.5.1"))
    )


def test_jetpacks_own_docker_is_left_alone() -> None:
    """JetPack brings docker.io: the script never runs over it. It gets Compose, and the runtime of its toolkit."""
    jetpack = change(
        READY,
        **JETSON,
        docker_version="24.0.5",
        client="24.0.5",
        compose="",
        installed=("docker.io", "zstd"),
        toolkit=True,
        runtimes=("runc",),
    )
    assert not steps.needs_script(jetpack)
    plan = planned(jetpack)
    assert titles(plan) == [
        "give Docker the runtime nvidia",
        "check that the robot reaches its package archive",
        "install Docker's Compose plugin",
        "let Docker read its settings; containers go on running",
    ]
    assert plan.steps[-1].title == "prove that Docker has the runtime nvidia"


def test_what_waits_for_a_reboot_is_told() -> None:
    """After a change, and each time until the robot was rebooted."""
    pi = robot().model_copy(update={"hardware": Hardware(interfaces=["i2c"])})
    off = change(READY, boot_folder="/boot/firmware")
    reboot = "; reboot it to switch on i2c: `fab run --hosts pi1 -- sudo reboot`"
    assert planned(off, of=pi).summary.endswith(reboot)
    on = change(off, interfaces=("i2c",), reboot_for=("i2c",))
    assert (planned(on, of=pi).steps, planned(on, of=pi).summary.endswith(reboot)) == ((), True)
    assert planned(change(on, reboot_for=()), of=pi).summary == "Docker 28.1.0 with Compose 2.35.1"


def test_the_clock_comes_first() -> None:
    """With a wrong clock apt believes nothing that it downloads."""
    plan = planned(change(BLANK, clock=NOW - 86400))
    assert plan.steps[0].argv == ("sudo", "-n", "date", "--utc", "--set", "@1800000000")


@pytest.mark.parametrize("off", [-59.0, 59.0])
def test_a_minute_is_near_enough(off: float) -> None:
    """The answer of a slow robot is some seconds old."""
    assert planned(change(READY, clock=NOW + off)).steps == ()


def test_root_needs_no_sudo_and_no_group() -> None:
    """A robot whose login is root may have no sudo at all."""
    plan = planned(change(BLANK, login_name="root", sudo="root"))
    assert not any("sudo" in step.argv for step in plan.steps)
    assert "let root use Docker" not in titles(plan)


def test_the_script_is_proved_by_its_checksum() -> None:
    """What ran as root is what the desktop looked at."""
    send = step(planned(BLANK), "send Docker's script")
    assert send.argv[-2:] == (".fleet/get-docker.sh", hashlib.sha256(SCRIPT).hexdigest())


def test_sending_the_script_keeps_its_promise(tmp_path: Path) -> None:
    """The very argv, run by a real shell, writes the file; one that was cut is not there, and so is never run."""
    send = step(planned(BLANK), "send Docker's script")
    assert subprocess.run(send.argv, input=SCRIPT[:-3], cwd=tmp_path, check=False).returncode == 74
    assert list((tmp_path / ".fleet").iterdir()) == []
    subprocess.run(send.argv, input=SCRIPT, cwd=tmp_path, check=True)
    assert (tmp_path / ".fleet/get-docker.sh").read_bytes() == SCRIPT


def test_a_pin_goes_to_the_script_and_is_proved() -> None:
    """The script takes a version as a pattern, and may install another one."""
    plan = planned(BLANK, of=robot(version="27.5.1"))
    assert step(plan, "install Docker 27.5.1").argv[-3:] == (".fleet/get-docker.sh", "--version", "27.5.1")
    assert step(plan, "prove that Docker answers").expect == "27.5.1"


def test_values_are_arguments_and_never_shell_text() -> None:
    """A login's odd name reaches the robot as one word."""
    plan = planned(change(BLANK, login_name="p i;reboot"))
    assert step(plan, "let p i;reboot use").argv[-1] == "p i;reboot"
    assert not any("reboot" in step.argv[i] for step in plan.steps for i in range(len(step.argv) - 1))


def test_what_a_failed_installation_left_is_removed_before_and_after() -> None:
    """A poisoned package source makes every later apt-get update fail."""
    plan = planned(change(BLANK, docker_source=True))
    assert titles(plan)[2] == "remove Docker's package source"
    assert [step.title for step in plan.recover] == ["remove Docker's package source"]


def test_packages_that_clash_go_first() -> None:
    """With Debian's docker-buildx there, Docker's own packages do not unpack."""
    plan = planned(change(BLANK, installed=("docker-buildx",)))
    assert step(plan, "remove docker-buildx").argv[-4:] == ("apt-get", "remove", "--yes", "docker-buildx")


def test_debians_engine_without_its_client_gets_the_client() -> None:
    """Debian 13 packs them apart; the script would replace the engine that runs."""
    plan = planned(change(BLANK, installed=("docker.io",)))
    assert not steps.needs_script(change(BLANK, installed=("docker.io",)))
    assert step(plan, "install docker-cli").argv[-1] == "docker-cli"


def test_every_step_is_bounded() -> None:
    """The script can hang for ever; the bound on the robot ends before the desktop gives up on it."""
    plan = steps.plan(
        robot=robot(), facts=BLANK, script=SCRIPT, now=NOW, by="", bounds=apt.Bounds(lock_timeout=5, limit=7)
    )
    assert all(step.limit for step in plan.steps)
    assert (step(plan, "install Docker").argv[-7:-2], step(plan, "install Docker").limit) == (
        ("5", "7", "5", "180", "10"),
        42.0,
    )


def test_a_dry_run_shows_script_and_settings() -> None:
    """What would be written and run can be read before."""
    text = "\n".join(lines(planned(BLANK)))
    assert hashlib.sha256(SCRIPT).hexdigest() in text
    assert '"max-size": "10m"' in text


@pytest.mark.parametrize(
    ("facts", "docker", "what", "cure"),
    [
        ({"sudo": "password"}, {}, "sudo asks pi for a password", "pi ALL=(ALL) NOPASSWD: ALL"),
        ({"sudo": "none"}, {}, "pi is not root, and sudo is not installed", "user: root"),
        (
            {"userland": "armhf"},
            {},
            "its kernel is 64-bit and its system (Debian GNU/Linux 13 (trixie)) is 32-bit",
            "64-bit Raspberry Pi OS",
        ),
        (
            {"userland": "amd64", "machine": "x86_64"},
            {},
            "it runs linux/amd64, and the inventory says linux/arm64",
            "set `platform: linux/amd64` for pi1",
        ),
        (
            {"userland": "riscv64", "machine": "riscv64"},
            {},
            "there are no images for its processor (riscv64)",
            "use a computer that runs linux/arm64",
        ),
        (
            {"userland": "armhf", "machine": "armv6l"},
            {},
            "there are no images for its processor (armv6l)",
            "use a computer that runs linux/arm64",
        ),
        ({"disk_free": 900_000_000}, {}, "it needs 1.0 GB of free disk, and has 900 MB", "apt-get clean"),
        ({"missing": ("flock",)}, {}, "commands that fleet needs are missing", "apt-get install util-linux"),
        ({"home_state": "foreign"}, {}, "pi cannot write to its home", "sudo chown pi:"),
        *(
            (
                {"docker_kind": kind, "docker_state": state, "installed": ("podman-docker",)},
                {},
                what,
                f"{cure}; then run the same command again",
            )
            for state in ("ready", "stopped", "absent")
            for kind, what, cure in (
                ("podman", "its `docker` command leads to podman", "on the robot (podman itself may stay)"),
                ("rootless", "its Docker is rootless", "`docker context use default` on the robot"),
                ("snap", "its Docker is snap's", "also removes its containers, images and volumes"),
            )
        ),
        ({"daemon_config": "{ bad"}, {}, "/etc/docker/daemon.json is not JSON", "sudo nano"),
        (
            {"docker_state": "ready", "docker_version": "28.1.0"},
            {"version": "27.5.1"},
            "Docker 28.1.0 is installed, and the inventory pins 27.5.1: fleet does not downgrade",
            "change the pin",
        ),
        (
            {"docker_state": "stopped", "client": "26.1.5+dfsg1"},
            {"version": "27.5.1"},
            "Docker 26.1.5+dfsg1 is installed, and the inventory pins 27.5.1: an upgrade would restart",
            "--only-upgrade",
        ),
    ],
)
def test_a_robot_that_cannot_be_made_ready_is_refused_with_a_cure(
    facts: dict[str, object], docker: dict[str, str], what: str, cure: str
) -> None:
    """Before anything is touched."""
    with pytest.raises(NotReady) as refused:
        planned(change(BLANK, **facts), of=robot(**docker))
    assert what in refused.value.what
    assert cure in refused.value.cure
    assert refused.value.cure
    assert "fab provision" not in refused.value.cure


def test_no_script_is_fetched_for_a_robot_with_another_engine() -> None:
    """Nor for one whose Docker is outside the PATH."""
    assert steps.needs_script(BLANK)
    assert not steps.needs_script(change(BLANK, docker_kind="snap"))


@pytest.mark.parametrize(
    "facts",
    [
        BLANK,
        change(BLANK, docker_source=True, installed=("docker-buildx",), interrupted=True),
        change(BLANK, installed=("docker.io",)),
        change(READY, compose="", installed=("docker-ce",)),
    ],
)
def test_no_step_is_cured_by_provisioning_again(facts: Facts) -> None:
    """The user just did that."""
    plan = planned(facts)
    for one in (*plan.steps, *plan.explain, *plan.recover, *plan.afterwards):
        assert "provision" not in one.cure
        assert "docker.list" not in one.cure


def test_a_pin_that_fits_is_content() -> None:
    """Debian's 26.1.5+dfsg1 is 26.1.5."""
    facts = change(READY, docker_version="26.1.5+dfsg1")
    assert planned(facts, of=robot(version="26.1.5")).steps == ()


def test_systemd_owns_the_stacks_where_the_inventory_says_so() -> None:
    """The script belongs to the login, the unit to root; once it is there, nothing is done. It is never removed."""
    owner = robot().model_copy(update={"boot": "systemd"})
    plan = planned(READY, of=owner)
    assert titles(plan) == [
        "write what systemd runs at power-on (~/.fleet/boot.sh)",
        "let systemd start the stacks at power-on (fleet-boot.service)",
    ]
    script, unit = plan.steps[:2]
    assert (script.argv[0], unit.argv[:2]) == ("sh", ("sudo", "-n"))
    assert isinstance(unit.feed, Bytes)
    assert b"\nUser=pi\n" in unit.feed.data
    there = hashlib.sha256(b"".join(steps.boot_unit("pi"))).hexdigest()
    assert not planned(change(READY, boot_unit=there), of=owner).steps
    assert not planned(change(READY, boot_unit=there)).steps
    with pytest.raises(NotReady, match="no systemd"):
        planned(change(READY, boot_unit="no systemd"), of=owner)
