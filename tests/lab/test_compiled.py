"""A C++ package on robots of both ARM platforms: compiled on this computer, without emulation, and heard there."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import LAB, Project, eventually, forget, on_each, running, wipe

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.lab.conftest import Lab, Pi

TALKER, LISTENER = f"{LAB}-talker", f"{LAB}-listener"
# What an ELF file calls a processor: bytes 18 and 19 of it.
MACHINES = {"pi1": "b7 00", "pi2": "28 00"}
HEARD = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z, -?\d+ ms ago")
SOURCE = "packages/listener/src/listener.cpp"


@pytest.fixture
def workspace(provisioned: Lab, tmp_path: Path) -> Iterator[Project]:
    """This repository with its stack of own packages, for one 64-bit and one 32-bit robot."""
    on_each(provisioned.pis, wipe)
    project = Project.copied(tmp_path, provisioned, image=TALKER)
    project.edit("docker/packages.yaml", "image: listener", f"image: {LISTENER}")
    project.edit("inventory.yaml", "\nstack: docker/compose.yaml", "\nstack: docker/packages.yaml")
    old = '\n  old: {robots: [pi2], platform: linux/arm/v7}\n  fleet: ["*"]'
    project.edit("inventory.yaml", '\n  fleet: ["*"]', old)
    yield project
    on_each(provisioned.pis, wipe)
    forget(TALKER, LISTENER)


def machine(pi: Pi) -> str:
    """What the node's program is for, as the robot has it."""
    command = "od -An -tx1 -j18 -N2 /opt/packages/lib/listener/listener"
    return pi.exec("docker", "exec", running(pi)["listener"][0], *command.split())


def test_a_node_in_c_plus_plus_runs_on_both_arm_platforms(workspace: Project) -> None:
    """It hears the talker beside it, and prints the delay. One that does not compile is a few lines."""
    robots = ("--hosts", "pi1,pi2")
    workspace.well("build", *robots, within=1200)
    workspace.well("ship", *robots, within=600)
    for pi in workspace.lab.pis[:2]:
        container = running(pi)["listener"][0]
        assert machine(pi) == MACHINES[pi.name]
        assert eventually(lambda: HEARD.search(pi.exec("docker", "logs", container)), within=90)  # noqa: B023

    workspace.edit(SOURCE, "ros::spin();", "ros::spn();")
    said = workspace.fab("build", "--hosts", "pi1", within=300)
    assert said.code
    assert "listener does not compile:" in said.all
    assert "'spn' is not a member of 'ros'" in said.all.replace("‘", "'").replace("’", "'")  # noqa: RUF001
    assert len(said.err.splitlines()) < 25
