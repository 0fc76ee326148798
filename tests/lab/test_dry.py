from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import HEAVY, LAB, Project, on_each, service, wipe

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi

EVERYTHING = r"""
docker ps --all --no-trunc --format '{{.ID}} {{.Names}} {{.State}}' | sort
docker ps --all --quiet | xargs --no-run-if-empty docker inspect --format '{{.Id}} {{.State.StartedAt}} {{.State.FinishedAt}}'
docker image ls --all --no-trunc --format '{{.Repository}}:{{.Tag}} {{.ID}}' | sort
docker volume ls --quiet; docker network ls --no-trunc --quiet
find /home/pi /etc /usr/local /opt /var/lib/dpkg /var/lib/apt -not -type s -printf '%p %i %s %m %u %T@ %l\n' | sort
find /home/pi /etc/docker -type f -exec sha256sum {} + | sort
systemctl list-units --all --plain --no-legend --type service --state running | cut -d ' ' -f 1 | grep -v -e '^user@' -e '^user-runtime-dir@'
cat /etc/group
"""
"""What a verb could change on a robot, as text."""


def everything(pi: Pi) -> list[str]:
    return pi.exec("sh", "-c", EVERYTHING).splitlines()


def here(project: Project) -> tuple[list[str], dict[str, bytes]]:
    """What a verb could change on the desktop. Docker lists the names of one image in any order."""
    listing = (
        "docker",
        "image",
        "ls",
        "--no-trunc",
        "--filter",
        f"reference={LAB}-*",
        "--format",
        "{{.Repository}}:{{.Tag}} {{.ID}}",
    )
    images = subprocess.run(listing, capture_output=True, text=True, check=True).stdout
    folders = (project.directory, project.lab.directory)
    files = {
        str(path): path.read_bytes()
        for folder in folders
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    return sorted(images.splitlines()), files


@pytest.fixture(scope="module")
def restless(
    provisioned: Lab,
    images: None,  # noqa: ARG001  they must be there
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Project]:
    """Robots where every verb has something to do: two releases, a third to ship, one stopped, one not quite ready."""
    on_each(provisioned.pis, wipe)
    project = Project.made(tmp_path_factory.mktemp("dry"), provisioned)
    for colour in ("red", "green"):
        project.colour(colour)
        project.well("ship")
    project.well("stop", "--hosts", "pi3")
    project.stack(tick=service(HEAVY, more="build: ../heavy"))
    project.write("heavy/Dockerfile", "FROM scratch\nCOPY Dockerfile /\n")
    unready = provisioned.pis[0]
    unready.exec("mv", "/etc/docker/daemon.json", "/root/daemon.json")
    yield project
    unready.exec("mv", "/root/daemon.json", "/etc/docker/daemon.json")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("ship --dry", "Receive the missing uploads"),
        ("--dry ship", "Receive the missing uploads"),
        ("ship --dry --json", '"plans"'),
        ("rollback --dry", "swap rollback tiny"),
        ("start --dry", "swap start tiny"),
        ("stop --dry", "swap stop tiny"),
        ("restart --dry", "swap restart tiny"),
        ("provision --dry", "daemon.json"),
        ("build --dry", "build --platform linux/arm64"),
    ],
)
def test_dry_shows_the_commands_and_changes_nothing(restless: Project, line: str, says: str) -> None:
    """What would run is printed; robots and desktop are afterwards as they were, to the byte and the second."""
    before = on_each(restless.lab.pis, everything), here(restless)
    said = restless.well(*line.split())
    assert says in said.out, said.out
    after = on_each(restless.lab.pis, everything), here(restless)
    for was, became in zip(before[0], after[0], strict=True):
        assert sorted(set(was) ^ set(became)) == []
    assert after[1] == before[1]


def test_dry_trust_records_nothing(restless: Project, pi: Pi) -> None:
    """The fingerprint is shown, and no file is made."""
    restless.write("new/inventory.yaml", f"robots: {{new: {pi.address}}}")
    before = here(restless)
    said = restless.fab("trust", "--dry", "--yes", "--inventory", "new/inventory.yaml")
    assert "SHA256:" in said.all
    assert here(restless) == before
