from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.card import cloud_init
from fleet.images.docker_cli import buildkit_client
from fleet.lab import lifecycle
from fleet.lab.virtual_pi import ensure_image, run_command
from tests.support.boot_partition import TRIXIE, boot_partition
from tests.support.first_boots import FIRST
from tests.support.lab_project import DOCKERFILE, LAB, ROOT, Project, built, forget, service

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi

BLANK = f"{LAB}-card"
IMAGE = f"{LAB}-first"
ARM = "COPY --from=base /lib/ld-linux-aarch64.so.1 /lib/aarch64-linux-gnu/libc.so.6 /lib/"
AMD = """\
COPY --from=base /lib64/ld-linux-x86-64.so.2 /lib64/
COPY --from=base /lib/x86_64-linux-gnu/libc.so.6 /lib/"""


@pytest.fixture(scope="module")
def image() -> str:
    """A virtual Pi before its first boot, with Debian's cloud-init."""
    recipe = Path(__file__).parent / "card"
    command = ("build", "--quiet", "--build-arg", f"PI={ensure_image(lifecycle.RECIPE, say=print)}")
    made = subprocess.run(
        (*buildkit_client(), *command, "--tag", BLANK, str(recipe)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    return BLANK


@pytest.fixture
def blank(own_lab: Lab, image: str) -> Pi:  # noqa: ARG001  it must be there
    """A Pi that has never booted: it is switched on by `insert`. Only its network and its address are there."""
    return own_lab.pis[0]


@pytest.fixture
def project(own_lab: Lab, blank: Pi, tmp_path: Path) -> Iterator[Project]:
    """A project with the Pi as a robot that nobody has met: no host key is recorded, and its login does not exist."""
    project = Project.made(tmp_path / "project", own_lab)
    robot = {
        "address": blank.address,
        "user": "operator",
        "identity_file": str(blank.key),
        "platform": "linux/amd64",
        "docker": {"script": str(ROOT / "fleet" / "lab" / "recipe" / "get-docker.sh")},
        "card": {
            "timezone": "Europe/Berlin",
            "wifi": {
                "country": "DE",
                "networks": [
                    {"name": "Lab: 5 GHz", "passphrase_from": "LAB_WIFI"},
                    {"name": "Guests", "open": True, "hidden": True},
                ],
            },
        },
    }
    project.write("inventory.yaml", json.dumps({"stack": "docker/compose.yaml", "robots": {"pi7": robot}}))
    project.write("image/Dockerfile", DOCKERFILE.replace(ARM, AMD))
    project.write("image/payload", "first")
    project.stack(tick=service(IMAGE, more=built("image")))
    yield project
    forget(IMAGE)


def insert(pi: Pi, boot: Path) -> None:
    """Switch the Pi on, with the card in it."""
    lab = pi.container.removesuffix(f"-{pi.name}")
    (virtual,) = lifecycle.list_(name=lab)
    docker("rm", "--force", pi.container)
    argv = run_command(
        replace(virtual, state="missing"), image=BLANK, network=f"fleet-{lab}", labels=(f"fleet.lab={lab}",)
    )
    docker(argv[0], "--volume", f"{boot}:/boot/firmware", *argv[1:])


def docker(*argv: str) -> None:
    subprocess.run(("docker", *argv), capture_output=True, check=True)


@pytest.mark.parametrize("raspberry_pi_os", [True, False])
def test_cloud_init_knows_every_key(image: str, tmp_path: Path, raspberry_pi_os: bool) -> None:
    """By its own schema, which also knows the keys that are out of date."""
    first = replace(FIRST, announces=True)
    for name, content in cloud_init.files(first, raspberry_pi_os=raspberry_pi_os, cmdlines={}).items():
        (tmp_path / name).write_text(content)
    schema = "cloud-init schema --schema-type"
    script = f"{schema} cloud-config --config-file user-data && {schema} network-config --config-file network-config"
    run = ("docker", "run", "--rm", "--volume", f"{tmp_path}:/card", "--workdir", "/card")
    done = subprocess.run((*run, image, "sh", "-c", script), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "deprecated" not in done.stdout + done.stderr


def test_a_card_makes_a_robot_that_is_trusted_at_its_first_contact(
    project: Project, blank: Pi, tmp_path: Path
) -> None:
    """A card, a boot, Docker, a release: nobody ran `fab trust`, and nobody logged in by hand."""
    boot = boot_partition(tmp_path / "bootfs", TRIXIE)
    wifi = {"LAB_WIFI": "correct horse"}
    words = ("card", "--hosts", "pi7", "--boot", str(boot))
    prepared = project.fab(*words, env=wifi)
    assert prepared.code == 0, prepared.all
    again = project.fab(*words, "--json", env=wifi)
    assert again.status == {"pi7": "unchanged"}

    insert(blank, boot)
    project.well("await", "--timeout", "120")
    assert (boot / "cmdline.txt").read_text().split("i=")[1].strip() == blank.exec(
        "cloud-init", "query", "instance_id"
    )

    public = next(line for line in project_key(project).splitlines() if blank.address in line).split()[2]
    assert public in blank.exec("cat", "/etc/ssh/ssh_host_ed25519_key.pub")
    assert blank.exec("sh", "-c", "ls /etc/ssh/ssh_host_*_key") == "/etc/ssh/ssh_host_ed25519_key"
    assert blank.exec("hostname") == "pi7"
    assert blank.exec("readlink", "/etc/localtime").endswith("Europe/Berlin")
    assert blank.exec("passwd", "--status", "operator").split()[1] == "L"
    assert "passwordauthentication no" in blank.exec("sshd", "-T").lower()
    blank.exec("cloud-init", "schema", "--system")
    blank.exec(
        "cloud-init",
        "schema",
        "--schema-type",
        "network-config",
        "--config-file",
        "/boot/firmware/network-config",
    )
    assert "Lab: 5 GHz" in blank.exec("sh", "-c", "cat /etc/netplan/*.yaml")
    assert "PRIVATE KEY" not in (boot / "user-data").read_text()

    counts_anew(project, blank, boot)
    project.well("provision", within=300)
    project.well("build", within=300)
    project.well("ship")
    assert project.well("status", "--json").json["pi7"]["healthy"]
    assert "pi7" in blank.exec("docker", "exec", running_tick(blank), "env")


def counts_anew(project: Project, blank: Pi, boot: Path) -> None:
    """A card that has booted is refused; if a person wants it anew, the next boot reads it, host key and all."""
    wifi = {"LAB_WIFI": "correct horse"}
    words = ("card", "--hosts", "pi7", "--boot", str(boot))
    refused = project.fab(*words, env=wifi)
    assert (refused.code, "pi7 has booted from the card" in refused.all) == (2, True)
    path = project.directory / "inventory.yaml"
    path.write_text(path.read_text().replace("Europe/Berlin", "Asia/Tokyo"))
    before = blank.exec("cat", "/etc/ssh/ssh_host_ed25519_key.pub")
    assert project.fab(*words, "--overwrite", env=wifi).code == 0
    docker("restart", blank.container)
    project.well("await", "--timeout", "120")
    assert blank.exec("readlink", "/etc/localtime").endswith("Asia/Tokyo")
    assert blank.exec("cat", "/etc/ssh/ssh_host_ed25519_key.pub") != before


def running_tick(pi: Pi) -> str:
    return pi.exec("docker", "ps", "--quiet")


def project_key(project: Project) -> str:
    return (project.directory / "known_hosts").read_text()
