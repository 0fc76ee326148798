from __future__ import annotations

import os
import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from tests.support.handmade import Engine

if TYPE_CHECKING:
    from pathlib import Path


def run(name: str, *, path: str = os.environ["PATH"]) -> subprocess.CompletedProcess[str]:
    argv = ("sh", "-c", onboard.text("prove_container.sh"), "prove_container", name)
    return subprocess.run(
        argv, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False, timeout=60
    )


@pytest.mark.usefixtures("desktop")
def test_a_container_of_this_system_runs() -> None:
    """Without any registry; its image is removed again."""
    engine = Engine()
    try:
        assert (run(engine.name).returncode, engine.tags()) == (0, [])
    finally:
        engine.clear()


@pytest.mark.usefixtures("desktop")
def test_a_container_that_does_not_run_is_an_error(tmp_path: Path) -> None:
    """The exit code is that of `docker run`, and the image is removed all the same."""
    docker = tmp_path / "docker"
    docker.write_text(f'#!/bin/sh\n[ "$1" != run ] || exit 125\nexec {shutil.which("docker")} "$@"\n')
    docker.chmod(0o755)
    engine = Engine()
    try:
        done = run(engine.name, path=f"{tmp_path}:{os.environ['PATH']}")
        assert (done.returncode, engine.tags()) == (125, [])
    finally:
        engine.clear()


def test_the_reason_is_told_and_not_that_there_is_no_image(tmp_path: Path) -> None:
    """If the image cannot be made there is none to remove."""
    docker = tmp_path / "docker"
    docker.write_text(
        '#!/bin/sh\n[ "$1" != import ] || { echo "no space left on device" >&2; exit 1; }\necho "No such image: $3" >&2; exit 1\n'
    )
    docker.chmod(0o755)
    done = run("fleet-proof", path=f"{tmp_path}:{os.environ['PATH']}")
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, "no space left on device")
