from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.cli import build
from fleet.cli.stacks import RobotStack
from fleet.config.inventory import StackFiles
from fleet.errors import ImageError
from fleet.images.docker_cli import docker
from fleet.images.emulation import desktop_platform
from tests.support.project import Done, Project
from tests.support.samples import PI, PROJECT, STACK

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from fleet.images.image import Image


def test_a_dry_run_of_a_build_shows_the_commands(mine: Project) -> None:
    """For the platforms of the robots that are meant."""
    done = mine.fleet("build", "--dry")
    assert done.code == 0
    assert "build fleet-test-none:latest-arm64 for linux/arm64\n  $ " in done.out
    assert " --platform linux/arm64 --tag fleet-test-none:latest-arm64 " in done.out


def test_flags_for_docker_build(mine: Project) -> None:
    """Another platform than the robots', and no old layers."""
    done = mine.fleet("build", "--dry", "--no-cache", "--pull", "--platform", "linux/arm/v7")
    assert done.code == 0
    assert " --platform linux/arm/v7 --tag fleet-test-none:latest-armv7 --no-cache --pull " in done.out
    assert done.out.count("  $ ") == 1
    wrong = mine.fleet("build", "--dry", "--platform", "arm64")
    assert (wrong.code, "there is no platform arm64\n  cure: there are: linux/arm64" in wrong.err) == (
        2,
        True,
    )


def test_pull_is_not_for_debian_that_fleet_makes(tmp_path: Path, desktop: None) -> None:  # noqa: ARG001
    """No registry has it; the person hears that."""
    (tmp_path / "inventory.yaml").write_text("stack: compose.yaml\nrobots: {pi1: , pi2: }\n")
    (tmp_path / "Dockerfile").write_text("ARG BASE\nFROM $BASE\n")
    (tmp_path / "compose.yaml").write_text(
        "services: {a: {image: a, build: {context: ., args: {BASE: '${FLEET_DEBIAN_BOOKWORM:-x}'}}}}\n"
    )
    done = Project(folder=tmp_path, robots={}).fleet("build", "--dry", "--pull")
    assert (done.code, "--pull" in done.out) == (0, False)
    assert done.err.startswith("a:latest-arm64: --pull has no effect, because")


@pytest.fixture
def real(tmp_path: Path, desktop: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[Project]:  # noqa: ARG001
    """A project with an image of its own, for this computer's platform; its logs are below it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    name = f"fleettest-build-{tmp_path.parent.parent.name}"
    (tmp_path / "inventory.yaml").write_text(
        f"stack: compose.yaml\ndefaults: {{platform: {desktop_platform()}}}\nrobots: {{pi1: , pi2: }}\n"
    )
    (tmp_path / "compose.yaml").write_text(f"services: {{a: {{image: {name}, build: .}}}}\n")
    (tmp_path / "Dockerfile").write_text("FROM scratch\nCOPY one /\n")
    (tmp_path / "one").write_text(f"{tmp_path}\n")
    yield Project(folder=tmp_path, robots={})
    for image in docker("images", "--quiet", name).split():
        docker("rmi", "--force", image)


def words(done: Done) -> str:
    """The line that says how the build of the one image ended, without the name."""
    (line,) = [line for line in done.err.splitlines() if " step" in line]
    return line.partition(" ")[2]


def test_a_build_says_what_was_cached_and_no_more(real: Project) -> None:
    """One line for an image of two robots; BuildKit's own words are in the log."""
    first = real.fleet("build")
    assert (first.code, "#1" in first.err) == (0, False)
    assert words(first).startswith("1 step, 0 cached, ")
    assert words(real.fleet("build")).startswith("1 step, all cached, ")
    assert words(real.fleet("build", "--no-cache")).startswith("1 step, 0 cached, ")
    (log,) = (real.folder / "cache/fleet/builds").iterdir()
    assert "COPY one /" in log.read_text()


def test_a_build_that_fails_shows_the_step(real: Project) -> None:
    """And where the rest is."""
    (real.folder / "Dockerfile").write_text("FROM scratch\nCOPY two /\n")
    done = real.fleet("build")
    assert done.code == 1
    assert "COPY two /" in done.err
    assert f"the whole output is in {real.folder}/cache/fleet/builds/fleettest-build-" in done.err


def test_a_build_warns_about_services_that_will_not_hear_each_other(own: Project) -> None:
    """On standard error, before the commands, which are still shown."""
    service = "{image: x, build: ., network_mode: host, environment: [ROS_DOMAIN_ID]}"
    (own.folder / "stack/compose.yaml").write_text(f"services: {{talker: {service}, listener: {service}}}\n")
    done = own.fleet("build", "--dry", "--hosts", "pi1")
    assert "pi1: no message of ROS 2 will arrive between listener and talker" in done.err
    assert "`ipc: host`" in done.err
    assert (done.code, "docker" in done.out) == (0, True)


def test_a_build_refuses_them_if_the_inventory_is_strict(own: Project) -> None:
    """Before anything is built, with the cure."""
    service = "{image: x, build: ., network_mode: host, environment: [ROS_DOMAIN_ID]}"
    (own.folder / "stack/compose.yaml").write_text(f"services: {{talker: {service}, listener: {service}}}\n")
    inventory = own.folder / "inventory.yaml"
    inventory.write_text(inventory.read_text().replace("defaults: {", "defaults: {ros: {strict: true}, "))
    done = own.fleet("build", "--hosts", "pi1")
    assert (done.code, done.out) == (2, "")
    assert "pi1: no message of ROS 2 will arrive between listener and talker" in done.err
    assert "`ipc: host`" in done.err


class Shelf:
    """A store whose images are all for another platform, or whose names Docker refuses."""

    def __init__(self, cure: str) -> None:
        self._cure = cure

    def find(self, reference: str, platform: str) -> Image:
        raise ImageError(f"{reference} is not for {platform}", cure=self._cure)


@pytest.mark.parametrize(
    ("cure", "told"),
    [("run `fab build`", "FROM --platform"), ("correct `image:`", "correct `image:`")],
)
def test_a_build_is_not_cured_by_building_again(cure: str, told: str) -> None:
    """What was just built is for another platform."""
    one = RobotStack(spec=StackFiles(files=()), project=PROJECT, stack=STACK, environment={}, warnings=())
    with pytest.raises(ImageError) as caught:
        build._built(one, PI, Shelf(cure))  # type: ignore[arg-type]  # noqa: SLF001
    assert caught.value.what == "talker is not for linux/arm64"
    assert told in caught.value.cure
    assert "fab build" not in caught.value.cure
