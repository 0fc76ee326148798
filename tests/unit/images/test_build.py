from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fleet.config.stack import Build, Stack
from fleet.errors import ComposeError, DesktopError
from fleet.images import build
from fleet.images.build import Command
from fleet.images.debian_base import Base
from fleet.images.emulation import desktop_platform

CLIENT = ("env", "DOCKER_BUILDKIT=1", "docker")


@pytest.fixture
def context(tmp_path: Path) -> Path:
    (tmp_path / "Dockerfile").write_text("FROM scratch\n")
    return tmp_path


def made_from(context: Path, *, target: str = "", arguments: tuple[tuple[str, str], ...] = ()) -> Build:
    return Build(context=context, dockerfile=context / "Dockerfile", target=target, arguments=arguments)


def stack(images: dict[str, str], builds: dict[str, Build] | None = None) -> Stack:
    return Stack(name="s", text="", images=images, builds=builds or {})


def planned(what: Stack, *platforms: str) -> tuple[Command, ...]:
    return build.plan(stack=what, platforms=platforms or ("linux/arm64",), client=CLIENT)


def test_one_build_per_platform_each_with_a_tag_of_its_own(context: Path) -> None:
    """BuildKit's classic store holds one platform under a name; a platform that many robots have is built once."""
    commands = planned(
        stack({"talker": "talker"}, {"talker": made_from(context)}),
        *("linux/arm64", "linux/arm/v7", "linux/arm64", "linux/amd64"),
    )
    assert commands == tuple(
        Command(
            title=f"build talker:latest-{tag} for {platform}",
            argv=(
                *(*CLIENT, "build", "--platform", platform, "--tag", f"talker:latest-{tag}"),
                *("--file", f"{context}/Dockerfile", str(context)),
            ),
            reference=f"talker:latest-{tag}",
            platform=platform,
        )
        for platform, tag in (("linux/arm64", "arm64"), ("linux/arm/v7", "armv7"), ("linux/amd64", "amd64"))
    )


def test_arguments_and_target_are_the_compose_files(context: Path) -> None:
    """A value may hold anything: it is one word of the command."""
    (command,) = planned(
        stack({"a": "a:1"}, {"a": made_from(context, target="run", arguments=(("X", "1 2"), ("Y", "a=b")))})
    )
    assert command.argv[len(CLIENT) :] == (
        *("build", "--platform", "linux/arm64", "--tag", "a:1-arm64"),
        *("--build-arg", "X=1 2", "--build-arg", "Y=a=b", "--target", "run"),
        *("--file", f"{context}/Dockerfile", str(context)),
    )


def test_services_that_share_an_image_build_it_once(context: Path) -> None:
    """Also where the first of them does not say how."""
    shared = stack(
        {"one": "a", "two": "a", "three": "b"}, {"two": made_from(context), "three": made_from(context)}
    )
    assert [command.title for command in planned(shared)] == [
        "build a:latest-arm64 for linux/arm64",
        "build b:latest-arm64 for linux/arm64",
    ]


def test_a_service_without_a_build_is_pulled_for_each_platform() -> None:
    """And named for it, or the next platform would take its place."""
    assert [command.argv for command in planned(stack({"db": "redis:7"}), "linux/arm64", "linux/arm/v7")] == [
        ("docker", "pull", "--platform", "linux/arm64", "redis:7"),
        ("docker", "tag", "redis:7", "redis:7-arm64"),
        ("docker", "pull", "--platform", "linux/arm/v7", "redis:7"),
        ("docker", "tag", "redis:7", "redis:7-armv7"),
    ]


@pytest.mark.parametrize(
    "line",
    [
        "ARG RUN_BASE=debian:bookworm-slim",
        'arg RUN_BASE="debian:bookworm-slim"',
        "  ARG   RUN_BASE='docker.io/library/debian:bookworm-slim'  ",
    ],
)
def test_a_debian_base_is_one_that_needs_no_registry(context: Path, line: str) -> None:
    """It is made from Debian's archive first, and named to the build."""
    (context / "Dockerfile").write_text(f"{line}\nFROM ${{RUN_BASE}}\n")
    (command,) = planned(stack({"a": "a"}, {"a": made_from(context)}), "linux/arm/v7")
    assert command.bases == (Base(suite="bookworm", platform="linux/arm/v7"),)
    given = command.argv.index("--build-arg")
    assert command.argv[given + 1] == "RUN_BASE=fleet-debian:bookworm-armhf"


def test_a_base_for_building_is_the_desktops(context: Path) -> None:
    """What runs while it is built runs here, without emulation."""
    (context / "Dockerfile").write_text(
        "ARG BUILD_BASE=debian:trixie-slim\nARG RUN_BASE=debian:bookworm-slim\n"
    )
    (command,) = planned(stack({"a": "a"}, {"a": made_from(context)}))
    assert command.bases == (
        Base(suite="trixie", platform=desktop_platform()),
        Base(suite="bookworm", platform="linux/arm64"),
    )


@pytest.mark.parametrize(
    "line", ["ARG BASE=ros:noetic", "ARG BASE=debian:bookworm", "# ARG BASE=debian:bookworm-slim", "ARG BASE"]
)
def test_other_bases_are_left_to_docker(context: Path, line: str) -> None:
    """Only the slim Debian is made here."""
    (context / "Dockerfile").write_text(f"{line}\n")
    (command,) = planned(stack({"a": "a"}, {"a": made_from(context)}))
    assert command.bases == ()
    assert "--build-arg" not in command.argv


def test_a_base_that_the_compose_file_names_is_the_persons_choice(context: Path) -> None:
    """A ROS image, or their own."""
    (context / "Dockerfile").write_text("ARG RUN_BASE=debian:bookworm-slim\n")
    own = made_from(context, arguments=(("RUN_BASE", "ros:noetic"),))
    (command,) = planned(stack({"a": "a"}, {"a": own}))
    assert command.bases == ()
    assert command.argv.count("--build-arg") == 1


def test_a_dockerfile_that_is_not_there(tmp_path: Path) -> None:
    """Refused before anything is built, with where it is named."""
    with pytest.raises(ComposeError) as caught:
        planned(stack({"a": "a"}, {"a": made_from(tmp_path)}))
    assert caught.value.what == f"cannot read {tmp_path}/Dockerfile: No such file or directory"
    assert caught.value.cure == "`build:` in the Compose file says where it is"


def test_a_dockerfile_in_an_old_encoding_is_read_all_the_same(context: Path) -> None:
    """A comment in Latin-1 is none of our business."""
    (context / "Dockerfile").write_bytes("# Größe\nARG B=debian:bookworm-slim\n".encode("latin-1"))
    assert planned(stack({"a": "a"}, {"a": made_from(context)}))[0].bases


def command(*argv: str) -> Command:
    return Command(title="build a", argv=argv, reference="a:latest-arm64", platform="linux/arm64")


def test_what_a_build_says_goes_to_standard_error(tmp_path: Path) -> None:
    """Standard output is for results: `fab build --json` must be JSON alone."""
    script = (
        "from fleet.images.build import Command, run\n"
        "run(Command(title='build a', argv=('sh', '-c', 'echo out; echo err >&2; cat'), reference='', platform=''),"
        " say=lambda text: None)"
    )
    done = subprocess.run(
        (sys.executable, "-c", script),
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
        cwd=tmp_path,
        input="never read",
        capture_output=True,
        text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ("", "out\nerr\n")


def test_a_build_that_fails_is_one_sentence() -> None:
    """BuildKit has told the reason."""
    said: list[str] = []
    with pytest.raises(DesktopError) as caught:
        build.run(command("sh", "-c", "exit 7"), say=said.append)
    assert caught.value.what == "build a failed with code 7"
    assert said == ["build a"]


def test_commands_read_as_one_could_type_them() -> None:
    """What ``--dry`` prints."""
    assert build.lines(
        (command("docker", "build", "--build-arg", "X=1 2"), replace(command("true"), title="b"))
    ) == [
        "build a",
        "  $ docker build --build-arg 'X=1 2'",
        "b",
        "  $ true",
    ]
