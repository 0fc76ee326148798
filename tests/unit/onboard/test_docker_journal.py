from __future__ import annotations

import os
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.diagnosis.explain import explain
from tests.support.robot_shell import EACH_SHELL

if TYPE_CHECKING:
    from pathlib import Path

CAUSE = (
    "unable to configure the Docker daemon with file /etc/docker/daemon.json: the following directives don't match any"
    " configuration option: nosuch"
)
# systemd 257, as often as it tries.
ATTEMPT = """Starting docker.service - Docker Application Container Engine...
{cause}
docker.service: Main process exited, code=exited, status=1/FAILURE
docker.service: Failed with result 'exit-code'.
Failed to start docker.service - Docker Application Container Engine.
docker.service: Scheduled restart job, restart counter is at 3.
"""
LAST = """docker.service: Start request repeated too quickly.
docker.service: Failed with result 'exit-code'.
Failed to start docker.service - Docker Application Container Engine.
"""


def run(folder: Path, shell: str, journal: str, *, active: bool = False) -> str:
    """Run the script on a robot with this journal."""
    (folder / "journal").write_text(journal)
    programs = {
        "systemctl": f"exit {0 if active else 3}",
        "journalctl": f'case "$*" in *"--unit docker --boot"*) cat {folder}/journal ;; esac',
    }
    for name, script in programs.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    argv = (*((shell, "sh") if shell == "busybox" else (shell,)), "-c", onboard.text("docker_journal.sh"))
    environment = {"PATH": f"{folder}:{os.environ['PATH']}"}
    return subprocess.run(argv, env=environment, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_the_reason_is_not_pushed_out_by_what_systemd_says(tmp_path: Path, shell: str) -> None:
    """A service that failed three times leaves more lines about that than anybody reads."""
    said = run(tmp_path, shell, ATTEMPT.format(cause=CAUSE) * 3 + LAST)
    assert said == f"{CAUSE}\n" * 3
    job = "Job for docker.service failed because the control process exited with error code."
    what, cure = explain(job, verb="provision", details=said)
    assert what.endswith("Docker rejects its configuration: " + CAUSE.partition("json: ")[2])
    assert "daemon.json" in cure


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_without_words_of_docker_those_of_systemd_are_shown(tmp_path: Path, shell: str) -> None:
    """As when the daemon's program is missing."""
    said = run(
        tmp_path,
        shell,
        "docker.service: Failed at step EXEC spawning /usr/bin/dockerd: No such file\n" + LAST,
    )
    assert "spawning /usr/bin/dockerd" in said


def test_a_docker_that_runs_has_nothing_to_explain(tmp_path: Path) -> None:
    """Its journal may hold old errors."""
    assert run(tmp_path, "sh", CAUSE, active=True) == ""
