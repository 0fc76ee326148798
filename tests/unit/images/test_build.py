from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fleet.config.compose import LEVELS, Project, Resolved
from fleet.config.stack import read
from fleet.errors import ComposeError
from fleet.images import build
from fleet.images.build import Command
from fleet.images.debian_base import Base
from fleet.images.emulation import desktop_platform

BUILDX = ("docker", "buildx")
OLD = ("env", "DOCKER_BUILDKIT=1", "docker")
ABOVE = Path("/tmp/t").joinpath(*["up"] * LEVELS)
CONTEXT = f"{ABOVE}/robot"


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """A folder with a Dockerfile, and a Compose file whose fourth line is `build:`."""
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "Dockerfile").write_text("FROM scratch\n")
    (folder / "compose.yaml").write_text("services:\n  a:\n    image: a\n    build:\n      context: .\n")
    return Project(files=(folder / "compose.yaml",), real=folder, folder=ABOVE / "robot")


def planned(
    project: Project,
    *,
    platform: str = "linux/arm64",
    client: tuple[str, ...] = BUILDX,
    **model: Any,  # noqa: ANN401
) -> tuple[Command, ...]:
    stack = read(Resolved(model={"name": "robot", **model}), project)
    return build.plan(stack, project, platform=platform, client=client)


def built(project: Project, *, client: tuple[str, ...] = BUILDX, **keys: Any) -> Command:  # noqa: ANN401
    """The command that builds one service."""
    service = {"image": "a", "build": {"context": CONTEXT, "dockerfile": "Dockerfile", **keys}}
    (made,) = planned(project, client=client, services={"a": service})
    return made


def test_a_build_is_for_one_platform_with_a_tag_of_its_own(project: Project) -> None:
    """The context is the project's folder as it is called here."""
    assert built(project) == Command(
        title="build a:latest-arm64 for linux/arm64",
        argv=(
            *(*BUILDX, "build", "--platform", "linux/arm64", "--tag", "a:latest-arm64"),
            *("--file", f"{project.real}/Dockerfile", str(project.real)),
        ),
        reference="a:latest-arm64",
        platform="linux/arm64",
    )


@pytest.mark.parametrize(
    ("key", "value", "flags"),
    [
        ("target", "run", ["--target", "run"]),
        ("network", "host", ["--network", "host"]),
        ("shm_size", "64m", ["--shm-size", "64m"]),
        ("isolation", "default", ["--isolation", "default"]),
        ("cache_from", ["x", "y"], ["--cache-from", "x", "--cache-from", "y"]),
        ("tags", ["t:1"], ["--tag", "t:1"]),
        ("ssh", ["default"], ["--ssh", "default"]),
        ("args", {"X": "1 2", "Y": True, "Z": None}, ["--build-arg", "X=1 2", "--build-arg", "Y=true"]),
        ("args", {"X": "a$$b"}, ["--build-arg", "X=a$b"]),
        ("labels", {"a.b": "c"}, ["--label", "a.b=c"]),
        ("no_cache", True, ["--no-cache"]),
        ("no_cache", False, []),
        ("pull", True, ["--pull"]),
        ("cache_to", ["type=inline"], ["--cache-to", "type=inline"]),
        ("entitlements", ["network.host"], ["--allow", "network.host"]),
        ("provenance", "mode=max", ["--provenance", "mode=max"]),
        ("sbom", True, ["--sbom", "true"]),
        ("extra_hosts", ["pi=10.0.0.1"], ["--add-host", "pi:10.0.0.1"]),
        (
            "ulimits",
            {"nproc": 5, "nofile": {"soft": 1, "hard": 2}},
            ["--ulimit", "nproc=5", "--ulimit", "nofile=1:2"],
        ),
        ("platforms", ["linux/arm64", "linux/amd64"], []),
        ("additional_contexts", {"lib": f"{CONTEXT}/lib"}, ["--build-context", "lib={real}/lib"]),
        ("additional_contexts", {"b": "docker-image://x"}, ["--build-context", "b=docker-image://x"]),
        ("x-mine", "y", []),
    ],
)
def test_each_key_becomes_a_flag(project: Project, key: str, value: Any, flags: list[str]) -> None:  # noqa: ANN401
    """A value may hold anything: it is one word of the command."""
    plain = built(project).argv
    words = [flag.replace("{real}", str(project.real)) for flag in flags]
    assert built(project, **{key: value}).argv == (*plain[:-3], *words, *plain[-3:])


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"privileged": True}, "services.a.build.privileged is not supported by fleet"),
        (
            {"platforms": ["linux/amd64"]},
            "services.a.build.platforms does not name the robot's platform linux/arm64",
        ),
        (
            {"additional_contexts": {"b": "service:c"}},
            "services.a.build.additional_contexts refers to service:c",
        ),
        (
            {"secrets": [{"source": "t"}]},
            "services.a.build.secrets names t, which is neither a file nor a variable",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_line(
    project: Project, keys: dict[str, Any], sentence: str
) -> None:
    """Before anything is built."""
    with pytest.raises(ComposeError) as caught:
        built(project, **keys)
    assert caught.value.what.startswith(f"{project.files[0]}:")
    assert caught.value.what.endswith(f": {sentence}")
    assert caught.value.what.removeprefix(f"{project.files[0]}:").partition(":")[0].isdigit()


@pytest.mark.parametrize("key", ["cache_to", "entitlements", "provenance", "sbom", "additional_contexts"])
def test_what_needs_buildx_is_refused_without_it(project: Project, key: str) -> None:
    """An old client would fail with a word that nobody knows."""
    with pytest.raises(ComposeError, match=rf"build\.{key} needs Docker's buildx plugin"):
        built(
            project, client=OLD, **{key: {"a": "docker-image://x"} if key == "additional_contexts" else ["x"]}
        )


def test_secrets_come_from_files_and_variables(project: Project) -> None:
    """They never become part of the command."""
    (made,) = planned(
        project,
        services={
            "a": {
                "image": "a",
                "build": {
                    "context": CONTEXT,
                    "secrets": [{"source": "one"}, {"source": "two", "target": "npm"}],
                },
            }
        },
        secrets={"one": {"file": f"{CONTEXT}/one.txt"}, "two": {"environment": "TOKEN"}},
    )
    assert f"id=one,src={project.real}/one.txt" in made.argv
    assert "id=npm,env=TOKEN" in made.argv


def test_a_dockerfile_in_the_compose_file(project: Project) -> None:
    """It is the command's standard input, with Compose's `$$` as `$`."""
    (made,) = planned(
        project,
        services={
            "a": {"image": "a", "build": {"context": CONTEXT, "dockerfile_inline": "FROM x\nRUN echo $$A\n"}}
        },
    )
    assert made.feed == "FROM x\nRUN echo $A\n"
    assert made.argv[-3:] == ("--file", "-", str(project.real))


@pytest.mark.parametrize("file", ["Dockerfile", "docker/Dockerfile"])
def test_a_git_context_is_left_to_docker(project: Project, file: str) -> None:
    """Its Dockerfile is in there."""
    address = "https://example.org/a.git#main:folder"
    argv = built(project, context=address, dockerfile=file).argv
    assert argv[-1] == address
    assert ("--file" in argv) == (file != "Dockerfile")


def test_a_dockerfile_that_is_not_there(project: Project) -> None:
    """Refused before anything is built."""
    with pytest.raises(ComposeError, match=r"build\.dockerfile names .*/no, which is not there"):
        built(project, dockerfile="no")


def test_services_that_share_an_image_make_it_once(project: Project) -> None:
    """Also where the first of them does not say how."""
    services = {
        "one": {"image": "a"},
        "two": {"image": "a", "build": {"context": CONTEXT}},
        "three": {"build": {"context": CONTEXT}},
    }
    assert [made.reference for made in planned(project, services=services)] == [
        "a:latest-arm64",
        "robot-three:latest-arm64",
    ]


def test_a_service_without_a_build_is_pulled_for_its_platform(project: Project) -> None:
    """And named for it, or the next platform would take its place."""
    services = {"db": {"image": "redis:7"}, "web": {"image": "x:1", "platform": "linux/amd64"}}
    assert [made.argv for made in planned(project, services=services)] == [
        ("docker", "pull", "--platform", "linux/arm64", "redis:7"),
        ("docker", "tag", "redis:7", "redis:7-arm64"),
        ("docker", "pull", "--platform", "linux/amd64", "x:1"),
        ("docker", "tag", "x:1", "x:1-amd64"),
    ]


def test_bases_of_debian_are_those_that_the_compose_file_asks_for(project: Project) -> None:
    """The robot's, and for what runs while it is built this computer's own; other variables are not fleet's."""
    project.files[0].write_text(
        "services: {a: {build: {args: [A=${FLEET_DEBIAN_BOOKWORM:-x}, B=$FLEET_BUILD_DEBIAN_TRIXIE, C=$DEBIAN]}}}"
    )
    assert build.bases(project, "linux/arm/v7") == {
        "FLEET_DEBIAN_BOOKWORM": Base(suite="bookworm", platform="linux/arm/v7"),
        "FLEET_BUILD_DEBIAN_TRIXIE": Base(suite="trixie", platform=desktop_platform()),
    }


def command(*argv: str) -> Command:
    return Command(title="build a", argv=argv, reference="a:latest-arm64", platform="linux/arm64")


def test_more_flags_go_into_each_build(project: Project) -> None:
    """`fab build --no-cache --pull`."""
    service = {"image": "a", "build": {"context": CONTEXT, "dockerfile": "Dockerfile"}}
    stack = read(Resolved(model={"name": "robot", "services": {"a": service}}), project)
    (made,) = build.plan(stack, project, platform="linux/arm64", client=BUILDX, flags=("--no-cache",))
    plain = built(project).argv
    assert made.argv == (*plain[:-3], "--no-cache", *plain[-3:])


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
