from __future__ import annotations

import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
import yaml

from fleet.starter import ci
from tests.support.project import FAB

if TYPE_CHECKING:
    from pathlib import Path

WANTED = ci.Wanted(hosts="all", platforms=["linux/arm64"], install="tools/fleet-1-py3-none-any.whl")


def job(wanted: ci.Wanted) -> dict[str, object]:
    """The job of a workflow, as YAML reads it."""
    made: dict[str, object]
    (made,) = yaml.safe_load(ci.github(wanted, branch="main"))["jobs"].values()
    return made


def runs(wanted: ci.Wanted) -> list[str]:
    steps = job(wanted)["steps"]
    assert isinstance(steps, list)
    return [step["run"] for step in steps if "run" in step]


@pytest.mark.parametrize(
    ("platforms", "runner", "emulated"),
    [
        (["linux/arm64"], "ubuntu-24.04-arm", False),
        (["linux/amd64"], "ubuntu-24.04", False),
        (["linux/arm/v7"], "ubuntu-24.04", True),
        (["linux/amd64", "linux/arm64"], "ubuntu-24.04", True),
    ],
)
def test_the_machine_fits_the_robots(platforms: list[str], runner: str, emulated: bool) -> None:
    """Nothing is emulated that a machine of GitHub can run."""
    wanted = replace(WANTED, platforms=platforms)
    assert job(wanted)["runs-on"] == runner
    assert any("qemu-user-static" in run for run in runs(wanted)) == emulated


@pytest.mark.parametrize("hosts", ["all", "pi*,x", "a b"])
@pytest.mark.parametrize("install", ["", "git+https://github.com/me/fleet@abc", "a wheel: #1.whl"])
def test_the_workflow_runs_what_the_script_runs(hosts: str, install: str) -> None:
    """Word for word: whoever reads one knows the other."""
    wanted = replace(WANTED, hosts=hosts, install=install)
    script = ci.shell(wanted)
    assert all(f"{command}\n" in script for command in runs(wanted))
    assert runs(wanted) == [*ci.installing(wanted), *ci.commands(wanted)]
    assert subprocess.run(("sh", "-n"), input=script, text=True, check=False).returncode == 0


def test_a_project_in_a_folder_of_its_repository() -> None:
    """Its commands run there; the artifact is named from the top."""
    wanted = replace(WANTED, folder="robots/my own")
    assert job(wanted)["defaults"] == {"run": {"working-directory": "robots/my own"}}
    steps = job(wanted)["steps"]
    assert isinstance(steps, list)
    assert steps[-1]["with"]["path"] == "robots/my own/bundle.tar"
    assert "\ncd 'robots/my own'\n" in ci.shell(wanted)


def test_variables_of_the_environment_are_secrets_of_the_repository() -> None:
    """For the commands that need them, and for nothing else."""
    steps = job(replace(WANTED, variables=["TOKEN"]))["steps"]
    assert isinstance(steps, list)
    assert {step["run"].split()[0] for step in steps if "env" in step} == {"fleet"}
    assert all(step["env"] == {"TOKEN": "${{ secrets.TOKEN }}"} for step in steps if "env" in step)


@pytest.mark.parametrize(
    ("to", "permissions", "user", "secrets"),
    [
        ("ghcr.io/me/robots", {"contents": "read", "packages": "write"}, "github.actor", ()),
        (
            "registry.local:5000/robots",
            {"contents": "read"},
            "secrets.REGISTRY_USER",
            ("REGISTRY_USER", "REGISTRY_TOKEN"),
        ),
    ],
)
def test_images_go_to_a_registry(
    to: str, permissions: dict[str, str], user: str, secrets: tuple[str, ...]
) -> None:
    """A pull request only builds; nobody is logged in for it."""
    wanted = replace(WANTED, to=to, variables=["A"])
    made = job(wanted)
    steps = made["steps"]
    assert isinstance(steps, list)
    assert made["permissions"] == permissions
    *_, build, login, push = steps
    assert (build["run"], "if" in build) == ("fleet build", False)
    assert login["run"].endswith(
        f'| docker login --username "$REGISTRY_USER" --password-stdin {wanted.registry}'
    )
    assert user in login["env"]["REGISTRY_USER"]
    assert push["run"] == f"fleet push --to {to}"
    assert push["env"] == build["env"] == {"A": "${{ secrets.A }}"}
    assert login["if"] == push["if"] == "github.event_name == 'push'"
    assert ci.login_secrets(wanted) == secrets
    script = ci.shell(wanted)
    assert f"\nfleet build\nfleet push --to {to}\n" in script
    assert f"docker login {wanted.registry}" in script
    assert ci.BUNDLE not in script


@pytest.mark.parametrize("to", ["", "ghcr.io/me/robots", "registry.local:5000/robots"])
def test_the_workflow_is_safe(tmp_path: Path, to: str) -> None:
    """zizmor finds nothing: actions are pinned, and permissions are the least."""
    path = tmp_path / ".github/workflows/robots.yml"
    path.parent.mkdir(parents=True)
    wanted = replace(WANTED, variables=["A"], platforms=["linux/arm/v7"], to=to)
    path.write_text(ci.github(wanted, branch="main"))
    zizmor = (str(FAB.with_name("zizmor")), "--offline", "--quiet", str(tmp_path))
    done = subprocess.run(zizmor, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_whose_a_workflow_is() -> None:
    """Its first line tells whether a person has changed the others."""
    old, new = ci.github(WANTED, branch="main"), ci.github(WANTED, branch="dev")
    assert ci.state(None, new) == "new"
    assert ci.state(new, new) == "same"
    assert ci.state(old, new) == "ours"
    for text in ("", "name: mine\n", old + "\n", old.replace("read", "write"), old.partition("\n")[2]):
        assert ci.state(text, new) == "theirs"
