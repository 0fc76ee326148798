"""A lab of the tests' own: three virtual Pis, made once, removed at the end. Nobody else's is touched."""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.errors import FleetError
from fleet.images import debian_base
from fleet.images.emulation import desktop_platform
from fleet.lab import lifecycle
from fleet.lab.virtual_pi import VirtualPi, ensure_image
from tests.support import lab_engines as labengines
from tests.support.lab_project import (
    DOCKERFILE,
    HEAVY,
    HEAVY_SIZE,
    LAB,
    TINY,
    Project,
    built,
    forget,
    on_each,
    service,
    wipe,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

HERE = Path(__file__).parent
COUNT = 3


@dataclass(frozen=True, kw_only=True)
class Pi:
    """One virtual Pi, with two ways in: as root through Docker, for breaking things, and as a person over SSH."""

    name: str
    address: str
    container: str
    key: Path

    def exec(self, *argv: str, timeout: float = 120) -> str:
        """Run as root, past SSH; the output. A command that fails fails the test with what it said."""
        done = subprocess.run(
            ("docker", "exec", self.container, *argv),
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
        assert done.returncode == 0, f"{self.name}: {argv}: {done.stdout}{done.stderr}"
        return done.stdout.strip()

    def ssh(
        self, command: str, *, stdin: bytes = b"", timeout: float = 300
    ) -> subprocess.CompletedProcess[bytes]:
        """Run as ``pi`` with OpenSSH's own client, whatever the exit code."""
        options = (
            "BatchMode=yes",
            "StrictHostKeyChecking=no",
            "UserKnownHostsFile=/dev/null",
            "LogLevel=ERROR",
        )
        settings = (part for option in options for part in ("-o", option))
        return subprocess.run(
            ("ssh", "-F", "none", "-i", str(self.key), *settings, f"pi@{self.address}", command),
            input=stdin,
            capture_output=True,
            timeout=timeout,
            check=False,
        )


@dataclass(frozen=True, kw_only=True)
class Lab:
    """Virtual Pis and the inventory that lists them."""

    name: str
    directory: Path
    pis: tuple[Pi, ...]

    @property
    def inventory(self) -> Path:
        """The inventory that `lab.up` wrote."""
        return self.directory / "inventory.yaml"


def made(name: str, directory: Path, *, count: int) -> Lab:
    """Start blank Pis."""
    return started(name, directory, up=lambda: lifecycle.up(count, directory=directory, name=name, say=print))


def started(name: str, directory: Path, *, up: Callable[[], None]) -> Lab:
    """Start the Pis. What stands in the way is said in one sentence, and fails the tests that need them."""
    try:
        up()
    except FleetError as error:
        pytest.fail(f"these tests need virtual Pis: {error}", pytrace=False)
    pis = (
        Pi(name=pi.name, address=pi.address, container=pi.container, key=directory / "id_ed25519")
        for pi in lifecycle.list_(name=name)
    )
    return Lab(name=name, directory=directory, pis=tuple(pis))


def paper(directory: Path) -> Lab:
    """A robot that is only written down, which is all that `fab build` asks for."""
    pi = VirtualPi(name="pi1", lab="paper", address="192.0.2.1", platform=lifecycle.WANTED)
    lifecycle.write_inventory((pi,), directory=directory, platform=pi.platform, recipe=lifecycle.RECIPE)
    return Lab(name=pi.lab, directory=directory, pis=())


@pytest.fixture(scope="session", autouse=True)
def only_one_session() -> Iterator[None]:
    """Two runs on one desktop would share container names: the second waits for the first.

    Tests side by side have names of their own, and one set of bases: who comes second finds them made.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet"
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / f"{LAB}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with (cache / "fleettest-bases.lock").open("w") as bases, contextlib.suppress(FleetError):
            fcntl.flock(bases, fcntl.LOCK_EX)
            ensure_image(lifecycle.RECIPE, say=print)
            for platform in {desktop_platform(), lifecycle.WANTED}:
                debian_base.ensure("bookworm", platform, say=print)
        yield


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """Three blank Pis for the whole session. Whoever changes one puts it back, or takes ``own_lab``."""
    directory = tmp_path_factory.mktemp(LAB)
    lifecycle.down(directory=directory, name=LAB, say=print)  # what a killed run left
    yield made(LAB, directory, count=COUNT)
    lifecycle.down(directory=directory, name=LAB, say=print)


@pytest.fixture
def pi(lab: Lab) -> Pi:
    """The first of the blank Pis."""
    return lab.pis[0]


@pytest.fixture
def own_lab(tmp_path: Path) -> Iterator[Lab]:
    """One blank Pi for one test, which may do to it what it likes."""
    name = f"{LAB}-own"
    lifecycle.down(directory=tmp_path / "lab", name=name, say=print)
    yield made(name, tmp_path / "lab", count=1)
    lifecycle.down(directory=tmp_path / "lab", name=name, say=print)


@pytest.fixture(scope="session")
def provisioned(lab: Lab, tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """The session's Pis, trusted and with Docker: `fab trust` and `fab provision`, once."""
    project = Project.made(tmp_path_factory.mktemp("provision"), lab)
    project.well("trust", "--yes")
    project.well("provision", within=900)
    return lab


@pytest.fixture(scope="session")
def engines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """The Pis of `labengines.ENGINES`, trusted. Whoever changes one puts it back."""
    name = f"{LAB}-engines"
    directory = tmp_path_factory.mktemp(name)
    lifecycle.down(directory=directory, name=name, say=print)
    lab = started(name, directory, up=lambda: labengines.up(name, directory))
    Project.made(tmp_path_factory.mktemp("trust"), lab).well("trust", "--yes")
    yield lab
    lifecycle.down(directory=directory, name=name, say=print)


@pytest.fixture(scope="session")
def images(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The images of the tests' stacks: one that is there in no time, and one whose bytes can be watched."""
    project = Project.made(tmp_path_factory.mktemp("images"), paper(tmp_path_factory.mktemp("paper")))
    for name, payload in ((TINY, b"tiny"), (HEAVY, os.urandom(HEAVY_SIZE))):
        project.write(f"{name}/Dockerfile", DOCKERFILE)
        (project.directory / name / "payload").write_bytes(payload)
    project.stack(tick=service(TINY, more=built(TINY)), heavy=service(HEAVY, more=built(HEAVY)))
    project.well("build", within=900)
    yield
    forget(TINY, HEAVY)


@pytest.fixture
def project(provisioned: Lab, images: None, tmp_path: Path) -> Project:  # noqa: ARG001  they must be there
    """A fresh project, and robots that nothing was shipped to."""
    on_each(provisioned.pis, wipe)
    return Project.made(tmp_path, provisioned)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of this folder, and run them last: what fails quickly should.

    Blank Pis come before provisioned ones, and those before the Pis of other engines.
    """
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.lab)

    def place(item: pytest.Item) -> tuple[bool, ...]:
        needs = item.fixturenames  # type: ignore[attr-defined]
        return HERE in item.path.parents, "engines" in needs, "provisioned" in needs

    items.sort(key=place)
