"""How much a ship sends over a bad Wi-Fi: bytes, never seconds."""

from __future__ import annotations

import json
import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from tests.support import lab_project, wifi
from tests.support.lab_project import DOCKERFILE, FAB, ROOT, Project, Running, eventually, running, service
from tests.support.wifi import Quality, Wifi, joined

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi
    from tests.support.lab_project import Said

IMAGE = "fleettest-wifi"
PAYLOAD, CODE = 20_000_000, 60_000
TALK = 52 * 1024
"""Bytes for everything else: logging in, asking, the manifest, and what is sent again where the link lost it."""

QUALITY = Quality(rate=50, round_trip=(5, 20), loss=0.01)

pytestmark = pytest.mark.skipif(bool(wifi.why_not()), reason=wifi.why_not())


@pytest.fixture
def link(pi: Pi) -> Iterator[Wifi]:
    """A desk, and the first Pi on its Wi-Fi."""
    pid = subprocess.run(
        ("docker", "inspect", "--format", "{{.State.Pid}}", pi.container), capture_output=True, check=True
    ).stdout
    with joined({pi.name: int(pid)}, quality=QUALITY) as link:
        yield link


@pytest.fixture
def on_air(project: Project, pi: Pi, link: Wifi) -> Iterator[Project]:
    """A project whose only robot is reached over the air, and an image of 20 MB with a little code on top."""
    project.write("app/Dockerfile", f"{DOCKERFILE}COPY code /\n")
    (project.directory / "app" / "payload").write_bytes(os.urandom(PAYLOAD))
    project.stack(tick=service(IMAGE, more=lab_project.built("app")))
    defaults = {"user": "pi", "identity_file": str(pi.key), "platform": platform(project.lab)}
    robots = {pi.name: {"address": link.addresses[pi.name]}}
    text = {"stack": "docker/compose.yaml", "defaults": defaults, "robots": robots}
    project.write("inventory.yaml", json.dumps({**text, "known_hosts": str(project.directory / "known")}))
    said(project, link, "trust", "--yes")
    yield project
    names = subprocess.run(
        ("docker", "image", "ls", "--quiet", IMAGE), capture_output=True, text=True, check=True
    ).stdout.split()
    subprocess.run(("docker", "image", "rm", "--force", *set(names)), capture_output=True, check=False)
    pi.exec("sh", "-c", "docker ps --all --quiet | xargs --no-run-if-empty docker rm --force")
    pi.exec("sh", "-c", f"docker image ls --quiet {IMAGE} | xargs --no-run-if-empty docker image rm --force")


def platform(lab: Lab) -> str:
    """What the lab's inventory says its Pis run."""
    return next(line.split()[1] for line in lab.inventory.read_text().splitlines() if "platform:" in line)


def start(project: Project, link: Wifi, *arguments: str) -> Running:
    """`fab`, at the desk."""
    person = {name: value for name, value in os.environ.items() if name != "FLEET_INVENTORY"}
    argv = link.at_desk(str(FAB), *arguments)
    return Running(argv, cwd=project.directory, env={**person, "PYTHONPATH": str(ROOT)})


def said(project: Project, link: Wifi, *arguments: str) -> Said:
    """`fab` at the desk, which must succeed."""
    with start(project, link, *arguments) as fab:
        done = fab.end(within=300)
    assert done.code == 0, done.all
    return done


def built(project: Project, code: bytes) -> None:
    """The image, with this code on top of what it had."""
    (project.directory / "app" / "code").write_bytes(code)
    project.well("build", within=600)


def sent(project: Project, link: Wifi, pi: Pi) -> int:
    """Ship; the bytes that reached the robot."""
    before = link.traffic(pi.name).payload
    said(project, link, "ship")
    assert running(pi)
    return link.traffic(pi.name).payload - before


def test_only_what_changed_travels(on_air: Project, link: Wifi, pi: Pi) -> None:
    """An image that cannot be compressed takes its own size once; new code on top of it takes that code's."""
    built(on_air, os.urandom(CODE))
    assert sent(on_air, link, pi) < 1.1 * (PAYLOAD + CODE) + 2_000_000
    built(on_air, os.urandom(CODE))
    assert sent(on_air, link, pi) < CODE + TALK


def test_a_ship_goes_on_where_the_link_was_cut(on_air: Project, link: Wifi, pi: Pi) -> None:
    """The command waits for the link, sends what had not arrived, and little more."""
    built(on_air, os.urandom(CODE))
    before = link.traffic(pi.name).payload
    with start(on_air, link, "ship") as fab:
        assert eventually(lambda: link.traffic(pi.name).payload - before > PAYLOAD / 2, within=120)
        link.cut(60)
        assert fab.end(within=200).code == 0
    assert link.traffic(pi.name).payload - before < 1.2 * (PAYLOAD + CODE) + 2_000_000
