from __future__ import annotations

import os
import tomllib
from pathlib import Path

from fleet.starter import example

ROOT = Path(__file__).parents[3]


def test_the_example_is_the_repository_s_talker() -> None:
    """Each file is the one that the repository builds and tests."""
    files = example.files()
    assert {"inventory.yaml", "docker/compose.yaml", "docker/Dockerfile", "talker/nodes/talker"} <= {*files}
    assert {name: path.resolve() for name, path in files.items()} == {name: ROOT / name for name in files}
    assert {name for name, path in files.items() if os.access(path, os.X_OK)} >= {
        "docker/entrypoint.sh",
        "talker/nodes/talker",
    }


def test_the_wheel_packs_what_the_example_needs() -> None:
    """The list of `pyproject.toml` is that of the module."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    packed = tomllib.loads(text)["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert packed == {part: f"fleet/starter/example/{part}" for part in example.PARTS}


def test_the_example_has_all_that_its_build_copies() -> None:
    """Every file that .dockerignore lets in is there."""
    allowed = [
        line[1:]
        for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
        if line.startswith("!")
    ]
    assert allowed
    assert not {
        one
        for one in allowed
        if not any(name == one or name.startswith(f"{one}/") for name in example.files())
    }


def test_an_installed_example_comes_without_what_the_installer_compiled(tmp_path: Path) -> None:
    """pip compiles every Python file that it installs."""
    for part in example.PARTS:
        path = tmp_path / part
        path.parent.mkdir(parents=True, exist_ok=True)
        if part == "talker":
            (path / "__pycache__").mkdir(parents=True)
            (path / "__pycache__/a.pyc").touch()
            (path / "package.xml").touch()
        else:
            path.touch()
    assert set(example.files(installed=tmp_path)) == ({*example.PARTS, *example.SHARED} - {"talker"}) | {
        "talker/package.xml"
    }
