from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.config import compose, inventory, stack
from fleet.errors import UsageError
from fleet.images import build
from fleet.starter.packages import Package
from fleet.starter.project import DISTROS, Draft, Request, check, draft, robots

if TYPE_CHECKING:
    from collections.abc import Sequence

PIS = Request(robots={"pi1": "192.168.1.11"})
NAV = Package(
    name="nav", folder="src/nav", ros=frozenset({2}), launches=("nav.launch.py",), programs=("driver",)
)
WHEEL = Package(name="wheel", folder="wheel", ros=frozenset({1}), launches=("wheel.launch",))
EITHER = Package(name="tools", folder="src/tools", ros=frozenset({1, 2}))
ROS = {"ROS_MASTER_URI": "http://pi1:11311", "ROS_HOSTNAME": "pi1"}


def made(*packages: Package, request: Request = PIS, there: Sequence[str] = ()) -> Draft:
    return draft(request, packages=packages, folder="My Robots", there=there)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", {}),
        ("pi1=192.168.1.11, pi2=pi2.local,", {"pi1": "192.168.1.11", "pi2": "pi2.local"}),
        ("pi1.local,arm", {"pi1": "pi1.local", "arm": "arm"}),
        ("10.0.0.1,fe80::1", {"robot1": "10.0.0.1", "robot2": "fe80::1"}),
    ],
)
def test_robots_are_names_and_addresses(text: str, found: dict[str, str]) -> None:
    """A robot without a name gets one from its address."""
    assert robots(text) == found


@pytest.mark.parametrize(
    "text", ["a b=x", "pi1=pi@x", "pi1=", "all=x", "pi1=x,pi1=y", "=,", "-x", "pi1=x:22"]
)
def test_robots_that_an_inventory_would_refuse_are_refused(text: str) -> None:
    """With the flag's name, before anything is written."""
    with pytest.raises(UsageError, match=r"^--robots"):
        robots(text)


@pytest.mark.parametrize(
    ("request_", "words", "cure"),
    [
        (Request(robots={}, platform="arm64"), "no platform arm64", "did you mean 'linux/arm64'?"),
        (Request(robots={}, platform="aarch64"), "no platform aarch64", "did you mean 'linux/arm64'?"),
        (Request(robots={}, platform="x"), "no platform x", "there are: linux/arm64"),
        (Request(robots={}, distro="humbel"), "no ROS distribution humbel", "did you mean 'humble'?"),
        (Request(robots={}, user="a b"), "--user: 'a b' must be a login name", ""),
    ],
)
def test_what_no_project_can_have_is_refused(request_: Request, words: str, cure: str) -> None:
    """With the nearest that it can have."""
    with pytest.raises(UsageError) as refused:
        check(request_)
    assert words in refused.value.what
    assert cure in refused.value.cure


PROJECTS = [
    (),
    (NAV,),
    (NAV, EITHER),
    (WHEEL,),
    (EITHER,),
    (Package(name="my_nav", folder=".", ros=frozenset({1})),),
]


@pytest.mark.parametrize("packages", PROJECTS, ids=[",".join(p.name for p in some) for some in PROJECTS])
def test_what_is_written_can_be_used(tmp_path: Path, packages: tuple[Package, ...]) -> None:
    """The inventory is valid, Compose accepts the stack, and the build can be planned."""
    for name, text in made(*packages).files.items():
        (tmp_path / name).write_text(text)
    (robot,) = inventory.load(tmp_path / "inventory.yaml").robots.values()
    with compose.opened(robot.stacks[0].files) as project:
        resolved = compose.resolve(project, environment=ROS)
        read = stack.read(resolved, project)
        commands = build.plan(read, project, platform=robot.platform, client=("docker",))
    assert resolved.warnings == ()
    assert [command.argv[-1] for command in commands] == [str(tmp_path)]


def test_the_schema_is_the_one_that_the_inventory_names() -> None:
    """Editors that read the first line of inventory.yaml find it."""
    files = made().files
    assert files["inventory.yaml"].splitlines()[0].endswith("$schema=inventory.schema.json")
    assert json.loads(files["inventory.schema.json"]) == inventory.json_schema()


def test_names_that_yaml_reads_as_something_else_are_quoted(tmp_path: Path) -> None:
    """A robot called `on`, an address `no`, a login `1e3`."""
    request = Request(robots={"on": "1.10", "1": "no", "pi-1": "10.0.0.1"}, user="1e3")
    text = made(request=request).files["inventory.yaml"]
    (tmp_path / "inventory.yaml").write_text(text)
    found = inventory.load(tmp_path / "inventory.yaml").robots.values()
    assert {robot.name: robot.address for robot in found} == request.robots
    assert {robot.user for robot in found} == {"1e3"}
    assert "  pi-1: 10.0.0.1\n" in text


def test_the_first_launch_file_starts_the_robot() -> None:
    """That of a bringup package before others; what else was found is a comment."""
    bringup = Package(name="nav_bringup", folder="src/b", ros=frozenset({2}), launches=("all.launch.py",))
    files = made(NAV, bringup)
    assert 'command: ["ros2", "launch", "nav_bringup", "all.launch.py"]' in files.files["compose.yaml"]
    assert "#   ros2 launch nav nav.launch.py\n" in files.files["compose.yaml"]
    assert "#   ros2 run nav driver\n" in files.files["compose.yaml"]
    assert "the robots will run: ros2 launch nav_bringup all.launch.py" in files.notes


def test_ros_1_without_a_launch_file_gets_a_master() -> None:
    """`roslaunch` would start one; `rosrun` does not."""
    node = Package(name="wheel", folder="wheel", ros=frozenset({1}), programs=("turn",))
    assert 'command: ["roscore"]' in made(node).files["compose.yaml"]
    assert "roscore" not in made(WHEEL).files["compose.yaml"]
    assert "roscore" not in made(NAV).files["compose.yaml"]


def test_packages_without_a_program_fail_with_a_reason() -> None:
    """The release would say what to write; nothing pretends to run."""
    files = made(EITHER)
    assert "exit 1" in files.files["compose.yaml"]
    assert "no launch file and no program was found: write `command:` into compose.yaml" in files.notes


@pytest.mark.parametrize(
    ("packages", "lines"),
    [
        ((NAV, EITHER), ['COPY ["src", "/ws/src"]']),
        ((WHEEL,), ['COPY ["wheel", "/ws/src/wheel"]']),
        ((Package(name="nav", folder="src", ros=frozenset({2})),), ['COPY ["src", "/ws/src/nav"]']),
        ((Package(name="nav", folder=".", ros=frozenset({2})),), ['COPY [".", "/ws/src/nav"]']),
    ],
)
def test_the_build_copies_the_packages(packages: tuple[Package, ...], lines: list[str]) -> None:
    """And .dockerignore lets them in."""
    files = made(*packages).files
    assert [line for line in files["Dockerfile"].splitlines() if line.startswith("COPY [")] == lines
    top = packages[0].folder.partition("/")[0]
    assert (f"\n!{top}\n" in files[".dockerignore"]) == (top != ".")


@pytest.mark.parametrize("distro", ["", *DISTROS])
def test_the_distribution(distro: str) -> None:
    """The one that was asked for, or the usual one of the packages' generation."""
    ros = DISTROS[distro] if distro else 2
    package = NAV if ros == 2 else WHEEL
    files = made(package, request=Request(robots={}, distro=distro)).files
    assert f"ros:{distro or 'jazzy'}-ros-base" in files["Dockerfile"]
    assert ("colcon" in files["Dockerfile"]) == (ros == 2)
    assert ("ros: {version: 2, domain: 0}\n" in files["inventory.yaml"]) == (ros == 2)


@pytest.mark.parametrize(
    ("packages", "request_", "words"),
    [
        (
            (NAV, WHEEL),
            PIS,
            "the package wheel is of ROS 1 and cannot be built with another package, of ROS 2",
        ),
        ((NAV,), Request(robots={}, distro="noetic"), "src/nav is of ROS 2 and cannot be built with noetic"),
        ((NAV,), Request(robots={}, platform="linux/arm/v7"), "no image of ROS 2 jazzy for linux/arm/v7"),
        ((Package(name="x", folder="a$b", ros=frozenset({2})),), PIS, "a Dockerfile cannot hold"),
    ],
)
def test_packages_that_cannot_be_built_are_refused(
    packages: tuple[Package, ...], request_: Request, words: str
) -> None:
    """Before anything is written, with a cure."""
    with pytest.raises(UsageError) as refused:
        made(*packages, request=request_)
    assert words in refused.value.what
    assert refused.value.cure


@pytest.mark.parametrize(
    "name", ["compose.yaml", "compose.yml", "docker-compose.yaml", "docker-compose.yml", "docker/compose.yml"]
)
def test_a_compose_file_that_is_there_is_the_stack(name: str) -> None:
    """It has its own way to be built."""
    made_ = made(NAV, there=[name, "Dockerfile"])
    files = made_.files
    assert made_.notes == (f"{name} is the stack, as it is: no Compose file and no Dockerfile are written",)
    assert {*files} == {"inventory.yaml", "inventory.schema.json"}
    assert f"\nstack: {name}\n" in files["inventory.yaml"]


def test_a_dockerfile_that_is_there_says_what_runs() -> None:
    """No command of ours and no argument that it may not have."""
    for packages in ((NAV,), ()):
        text = made(*packages, there=["Dockerfile"]).files["compose.yaml"]
        assert "command:" not in text
        assert "args:" not in text


@pytest.mark.parametrize("packages", [(), (NAV,), (WHEEL,), (NAV, EITHER)])
def test_the_dockerfile_is_what_a_linter_expects(packages: tuple[Package, ...], tmp_path: Path) -> None:
    """With its own rules, as people run it in their project."""
    path = tmp_path / "Dockerfile"
    path.write_text(made(*packages).files["Dockerfile"])
    program = Path(sys.executable).with_name("hadolint")
    done = subprocess.run((program, path), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
