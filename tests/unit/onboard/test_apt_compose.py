from __future__ import annotations

import os
import shlex
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path


def run(folder: Path, *, candidates: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Run the script with an apt that knows these packages (``name=version``), and notes what it is asked."""
    programs = {
        "apt-cache": f'for each in {shlex.join(candidates.split())}; do [ "${{each%%=*}}" != "$2" ] || echo "  Candidate: ${{each#*=}}"; done',
        "apt-get": f'echo "$@" >> "{folder}/asked"; [ "$1" != "{"install" if code == 5 else "update"}" ] || exit {code}',
    }
    for name, script in programs.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    environment = {"PATH": f"{folder}:{os.environ['PATH']}"}
    argv = ("sh", "-c", onboard.text("apt_compose.sh"))
    return subprocess.run(argv, env=environment, capture_output=True, text=True, check=False, timeout=30)


@pytest.mark.parametrize(
    ("candidates", "package"),
    [
        ("docker-compose-plugin=5:2.35.1-1 docker-compose=2.26.1", "docker-compose-plugin"),
        ("docker-compose-v2=2.20.2+ds1", "docker-compose-v2"),
        ("docker-compose=2.26.1-4", "docker-compose"),
        ("docker-compose-v2=1.29.2 docker-compose=10.0", "docker-compose"),
    ],
)
def test_the_first_package_that_has_the_plugin_is_installed(
    tmp_path: Path, candidates: str, package: str
) -> None:
    """The lists are updated first; version 1 is another program."""
    assert run(tmp_path, candidates=candidates).returncode == 0
    asked = (tmp_path / "asked").read_text().splitlines()
    assert asked == ["update -qq", f"install --yes --no-install-recommends {package}"]


@pytest.mark.parametrize("candidates", ["", "docker-compose=1.29.2-3", "docker-compose=(none)"])
def test_a_system_without_the_plugin_is_an_error(tmp_path: Path, candidates: str) -> None:
    """Debian 12 has only version 1."""
    done = run(tmp_path, candidates=candidates)
    assert (done.returncode, done.stderr) == (1, "no package of this system brings the Compose plugin\n")


@pytest.mark.parametrize("code", [5, 100])
def test_a_failure_of_apt_is_the_exit_code(tmp_path: Path, code: int) -> None:
    """5 is that of `install` here, 100 that of `update`, after which nothing is installed."""
    assert run(tmp_path, candidates="docker-compose=2.26.1", code=code).returncode == code
    assert len((tmp_path / "asked").read_text().splitlines()) == (2 if code == 5 else 1)
