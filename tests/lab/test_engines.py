from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_engines import ENGINES, Engine
from tests.support.lab_project import ANYWHERE, Project, current, environment, on_each, running, service, wipe

if TYPE_CHECKING:
    from pathlib import Path

    from tests.lab.conftest import Lab, Pi

ALL = tuple(engine.name for engine in ENGINES)


def of(engines: Lab, engine: Engine) -> Pi:
    return next(pi for pi in engines.pis if pi.name == engine.name)


@pytest.fixture
def project(engines: Lab, images: None, tmp_path: Path) -> Project:  # noqa: ARG001  they must be there
    """A fresh project, and one robot of each kind that nothing was shipped to."""
    on_each(engines.pis, wipe)
    made = Project.made(tmp_path, engines)
    made.stack(tick=service(times=ANYWHERE))
    return made


def recorded(pi: Pi) -> str:
    """Which processor the running image says it is for: not the Pi's own, so the container proves that emulation works."""
    container, _ = running(pi)["tick"]
    image = pi.exec("docker", "inspect", "--format", "{{.Image}}", container)
    return pi.exec("docker", "image", "inspect", "--format", "{{.Architecture}}", image)


@pytest.mark.parametrize("engine", ENGINES, ids=ALL)
def test_a_pi_has_the_engine_and_the_store_that_it_is_named_after(engines: Lab, engine: Engine) -> None:
    """What the login sees that ships to it, without root: a test that passes on another engine would prove nothing."""
    done = of(engines, engine).ssh("docker info --format '{{json .}}' && docker compose version --short")
    assert done.returncode == 0, done.stderr
    info, compose = done.stdout.decode().splitlines()
    found = json.loads(info)
    snapshots = ["driver-type", "io.containerd.snapshotter.v1"] in found["DriverStatus"]
    assert found["ServerVersion"].startswith(f"{engine.version}.")
    assert (found["Driver"], snapshots) == (engine.store, engine.store == "overlayfs")
    assert compose.removeprefix("v").startswith(f"{engine.compose}.")


@pytest.mark.parametrize("engine", ENGINES, ids=ALL)
def test_a_pi_has_what_a_transfer_may_use(engines: Lab, engine: Engine) -> None:
    """A transfer may count on that much. Not on all of Python: python3-minimal has no tarfile, and bookworm's no json."""
    needs = "zstd --version && python3 -c 'import hashlib, os, struct, zlib'"
    done = of(engines, engine).ssh(f"{needs} && . /etc/os-release && echo $VERSION_CODENAME")
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode().split()[-1] == engine.suite


def test_one_ship_reaches_every_engine(project: Project) -> None:
    """The same fleet, whatever each robot has: shipped, healthy, content the second time, and back again."""
    project.colour("red")
    assert project.well("ship", "--json").status == dict.fromkeys(ALL, "done")
    assert project.well("ship", "--json").status == dict.fromkeys(ALL, "unchanged")
    first = [current(pi) for pi in project.lab.pis]
    assert [running(pi)["tick"][1] for pi in project.lab.pis] == first
    assert on_each(project.lab.pis, recorded) == ["arm64"] * len(ALL)
    project.colour("green")
    assert project.well("ship", "--json").status == dict.fromkeys(ALL, "done")
    assert [environment(pi)["COLOUR"] for pi in project.lab.pis] == ["green"] * len(ALL)
    assert project.well("rollback", "--json").status == dict.fromkeys(ALL, "done")
    assert [current(pi) for pi in project.lab.pis] == first
