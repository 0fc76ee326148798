from __future__ import annotations

from pathlib import Path

import pytest

from fleet.config.stack import Build, Stack, read_stack
from fleet.errors import ComposeError

HERE = Path(__file__).parents[3]


def stack(tmp_path: Path, text: str, *, folder: str = "") -> Stack:
    """The stack of a Compose file with this text."""
    path = tmp_path / folder / "compose.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return read_stack(path)


def test_reading_the_projects_own_stack() -> None:
    """The Compose file that ships with the project names one image, and says how it is built."""
    assert read_stack(HERE / "docker/compose.yaml") == Stack(
        name="talker",
        text=(HERE / "docker/compose.yaml").read_text(),
        images={"talker": "talker"},
        builds={"talker": Build(context=HERE, dockerfile=HERE / "docker/Dockerfile")},
    )


@pytest.mark.parametrize(
    ("build", "expected"),
    [
        ("build: .", Build(context=Path(), dockerfile=Path("Dockerfile"))),
        ("build: ../src", Build(context=Path("../src"), dockerfile=Path("../src/Dockerfile"))),
        (
            "build: {context: .., dockerfile: docker/D}",
            Build(context=Path(".."), dockerfile=Path("../docker/D")),
        ),
        ("build: {target: run}", Build(context=Path(), dockerfile=Path("Dockerfile"), target="run")),
        (
            "build: {args: {A: 1, B: two, C: true, D: null}}",
            Build(
                context=Path(),
                dockerfile=Path("Dockerfile"),
                arguments=(("A", "1"), ("B", "two"), ("C", "true")),
            ),
        ),
        (
            "build: {args: [A=1, B=x=y, FROM_ENVIRONMENT]}",
            Build(context=Path(), dockerfile=Path("Dockerfile"), arguments=(("A", "1"), ("B", "x=y"))),
        ),
    ],
)
def test_how_an_image_is_built(tmp_path: Path, build: str, expected: Build) -> None:
    """Compose's short and long form; paths count from the Compose file, the Dockerfile from the context."""
    said = stack(tmp_path, f"services:\n  a:\n    image: a\n    {build}\n", folder="here").builds["a"]
    assert said.context == (tmp_path / "here" / expected.context).resolve()
    assert said.dockerfile.resolve() == (tmp_path / "here" / expected.dockerfile).resolve()
    assert (said.target, said.arguments) == (expected.target, expected.arguments)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "is empty"),
        ("name: x\n", "contains no service"),
        ("services: {}\n", "contains no service"),
        ("services: [a]\n", "contains no service"),
        ("services:\n  a:\n", "2: services.a: names no image"),
        ("services:\n  a:\n    build: .\n", "2: services.a: names no image"),
        ("services:\n  a: 5\n", "2: services.a: names no image"),
        ("services:\n  ok:\n    image: ok\n  a:\n    image: [x]\n", "4: services.a: names no image"),
        ("services:\n  a:\n    image: x:${TAG}\n", "2: services.a.image: x:${TAG} contains a variable"),
        (
            "services:\n  a:\n    image: x\n    build: [x]\n",
            "2: services.a.build: is neither a path nor a mapping",
        ),
        (
            "services:\n  a:\n    image: x\n    build: {args: 5}\n",
            "2: services.a.build.args: is neither a mapping nor a list",
        ),
        ("services: [\n", ""),
    ],
)
def test_a_compose_file_that_cannot_be_used_is_refused_with_its_line(
    tmp_path: Path, text: str, what: str
) -> None:
    """Each mistake names the file, and the line of the service where it is one's."""
    with pytest.raises(ComposeError) as caught:
        stack(tmp_path, text)
    assert str(tmp_path / "compose.yaml") in caught.value.what
    assert what in caught.value.what


def test_a_compose_file_that_is_not_there_is_refused_with_where_it_is_named(tmp_path: Path) -> None:
    """The inventory names it, and there it is cured."""
    with pytest.raises(ComposeError) as caught:
        read_stack(tmp_path / "none.yaml")
    assert str(tmp_path / "none.yaml") in caught.value.what
    assert caught.value.cure == "`stack:` in the inventory names the Compose file"


@pytest.mark.parametrize(
    ("name", "folder", "project"),
    [
        ("name: talker\n", "x", "talker"),
        ("name: My Robot's\n", "x", "myrobots"),
        ("", "rover", "rover"),
        ("", "rover/docker", "rover"),
        ("", "_Rover.2", "rover2"),
        ("name: '...'\n", "x", "stack"),
        ("name: 5\n", "x", "5"),
    ],
)
def test_the_projects_name(tmp_path: Path, name: str, folder: str, project: str) -> None:
    """What Compose would make of it: lower case, no odd letters, a letter or digit first."""
    assert stack(tmp_path, f"{name}services:\n  a:\n    image: a\n", folder=folder).name == project
