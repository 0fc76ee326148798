from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.config import compose, docker_rules
from fleet.errors import ComposeError

if TYPE_CHECKING:
    from pathlib import Path


def check(folder: Path, text: str) -> None:
    (folder / "compose.yaml").write_text(f"services:\n  node:\n    {text}\n")
    with compose.opened((folder / "compose.yaml",)) as project:
        docker_rules.check(compose.resolve(project, environment={}), project)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("image: Talker", "compose.yaml:3: services.node.image: 'Talker' is not a name of an image"),
        ("image: a b", "compose.yaml:3: services.node.image: 'a b' is not a name of an image"),
        ("image: talker:${TAG}", """'talker:' is not a name of an image (The "TAG" variable is not set."""),
        ("image: http://registry/x", "services.node.image: 'http://registry/x' is not a name of an image"),
        (
            "image: x\n    restart: sometimes",
            "compose.yaml:4: services.node.restart: 'sometimes' is not a restart policy",
        ),
        (
            "provider: {type: cloud}",
            "compose.yaml:3: services.node.provider: robots have no program that provides a service",
        ),
        (
            "image: x\n    volumes: ['w:/w:ro']",
            "compose.yaml:4: services.node.volumes: 'ro' is not a path in a container",
        ),
        (
            "image: x\n    volumes: [{type: image, source: y, target: /y}]",
            "compose.yaml:4: services.node.volumes: fleet cannot bring a volume of the type image to a robot",
        ),
    ],
)
def test_what_only_docker_would_refuse_is_refused_here(tmp_path: Path, text: str, what: str) -> None:
    """With file and line, before anything is built or sent."""
    with pytest.raises(ComposeError) as caught:
        check(tmp_path, text)
    assert what in caught.value.what
    assert caught.value.cure


@pytest.mark.parametrize(
    "text", ["image: x", "build: .", "image: x\n    restart: on-failure:3", 'image: x\n    restart: "no"']
)
def test_what_docker_takes_passes(tmp_path: Path, text: str) -> None:
    """Also a service that has no name for its image."""
    check(tmp_path, text)
