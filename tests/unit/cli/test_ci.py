from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from fleet.bundle import read
from fleet.images.docker_cli import docker
from fleet.images.emulation import desktop_platform
from tests.support.project import FAB, ROOT, Project

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

WHEEL = ("--install", "tools/fleet.whl")


@pytest.fixture
def mine(tmp_path: Path) -> Project:
    """A project in a repository, with one robot."""
    (tmp_path / ".git").mkdir()
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots/inventory.yaml").write_text(
        f"stack: compose.yaml\ndefaults: {{platform: {desktop_platform()}}}\nrobots: {{pi1: 192.0.2.1}}\n"
    )
    return Project(folder=tmp_path / "robots", robots={})


def test_a_workflow_is_written_once(mine: Project) -> None:
    """At the top of the repository; what a person has changed is kept."""
    path = mine.folder.parent / ".github/workflows/robots.yml"
    assert mine.fleet("ci.github", *WHEEL, "--dry").out.startswith("# Written by")
    assert not path.exists()
    assert f"wrote {path}" in mine.fleet("ci.github", *WHEEL).out
    assert 'working-directory: "robots"' in path.read_text()
    assert "is as it should be" in mine.fleet("ci.github", *WHEEL).out
    assert f"wrote {path}" in mine.fleet("ci.github", *WHEEL, "--branch", "dev").out
    path.write_text(text := path.read_text() + "# mine\n")
    done = mine.fleet("ci.github", *WHEEL)
    assert (done.code, path.read_text()) == (2, text)
    assert "it is kept\n  cure: move it away" in done.err


def test_who_installs_fleet_must_be_said(mine: Project) -> None:
    """PyPI's `fleet` is another program."""
    for verb in ("ci.github", "ci.shell"):
        done = mine.fleet(verb)
        assert (done.code, "--install git+https://" in done.err) == (2, True)


def test_images_for_a_registry(mine: Project) -> None:
    """Its secrets are named; what is no registry is refused."""
    done = mine.fleet("ci.github", *WHEEL, "--to", "registry.local:5000/robots")
    assert (
        "set these secrets in the repository on GitHub: REGISTRY_USER, REGISTRY_TOKEN" in done.out + done.err
    )
    assert "a bundle holds" not in done.out + done.err
    done = mine.fleet("ci.shell", *WHEEL, "--to", "https://registry.local")
    assert (done.code, "--to must be a host" in done.err) == (2, True)


def test_a_folder_that_cannot_be_written(mine: Project) -> None:
    """A file is where the folder must be."""
    (mine.folder.parent / ".github").write_text("")
    done = mine.fleet("ci.github", *WHEEL)
    assert (done.code, "cannot be written" in done.err, "Traceback" in done.err) == (1, True, False)


@pytest.fixture
def stack(mine: Project, desktop: None) -> Iterator[Project]:  # noqa: ARG001
    """The project has a stack that any computer builds, and the wheel of this repository."""
    (mine.folder / "compose.yaml").write_text(
        "services: {a: {build: ., image: fleet-test-ci, command: [/a]}}\n"
    )
    (mine.folder / "Dockerfile").write_text("FROM scratch\nCOPY inventory.yaml /a\n")
    build = (str(FAB.with_name("python")), "-m", "hatchling", "build", "-t", "wheel", "-d", str(mine.folder))
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    yield mine
    tag = f"fleet-test-ci:latest-{desktop_platform().partition('/')[2]}"
    docker("image", "rm", "--force", tag)


def test_the_script_makes_a_bundle_where_nothing_is_installed(stack: Project, tmp_path: Path) -> None:
    """A new Python, and the commands as they are printed; the bundle is whole, and for the robot."""
    (wheel,) = stack.folder.glob("*.whl")
    subprocess.run((sys.executable, "-m", "venv", str(tmp_path / "clean")), check=True)
    script = stack.fleet("ci.shell", "--install", wheel.name).out
    environment = {name: value for name, value in stack.environment.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        ("sh", "-e"),
        input=script,
        cwd=stack.folder.parent,
        env={**environment, "PATH": f"{tmp_path}/clean/bin:{environment['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    with read.opened(stack.folder / "bundle.tar") as bundle:
        assert [robot.name for robot in bundle.bundle.robots] == ["pi1"]
