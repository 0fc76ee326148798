from __future__ import annotations

import io
import os
import subprocess
import tarfile
from typing import TYPE_CHECKING

from fleet.plan import compose_steps
from fleet.plan.step import Record
from fleet.robot import paths
from tests.support.samples import PI, release

if TYPE_CHECKING:
    from pathlib import Path

RECORD = Record(verb="ship", release="3f2a9c1b5d0e", by="tim@desktop")


def test_compose_runs_in_the_release_and_heeds_its_env_file_only() -> None:
    """A login's own ROS_MASTER_URI would win over ``.env``, so the variables of the release are unset first."""
    robot = PI.model_copy(update={"environment": {"TALKER_RATE": "2"}})
    argv = compose_steps.compose(robot, "abc", "ps")
    assert argv[:3] == ("env", "-C", ".fleet/releases/abc")
    assert argv[-3:] == ("docker", "compose", "ps")
    unset = argv[3:-3]
    assert unset[::2] == ("-u",) * (len(unset) // 2)
    assert {"TALKER_RATE", "ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "COMPOSE_PROJECT_NAME"} <= set(
        unset[1::2]
    )


def test_env_as_it_is_called_reads_the_release_and_not_the_login(tmp_path: Path) -> None:
    """The argv works with the ``env`` of Debian: it changes the folder and drops the login's variables."""
    folder = tmp_path / paths.folder("abc")
    folder.mkdir(parents=True)
    argv = compose_steps.compose(PI, "abc")[: -len(("docker", "compose"))]
    script = "pwd; echo ${ROS_MASTER_URI-unset} ${OTHER-unset}"
    environment = {"PATH": os.environ["PATH"], "ROS_MASTER_URI": "http://elsewhere:11311", "OTHER": "kept"}
    done = subprocess.run(
        (*argv, "sh", "-c", script), cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{folder}\nunset kept\n"


def test_starting_never_pulls_or_builds_and_is_given_time() -> None:
    """A robot has no registry; Compose waits for health, and the step outlives Compose's own wait."""
    step = compose_steps.start(PI, "abc", wait=120)
    assert step.title == "start release abc"
    assert step.argv[step.argv.index("compose") :] == (
        "compose",
        "up",
        "--detach",
        "--wait",
        "--wait-timeout",
        "120",
        "--no-build",
        "--pull",
        "never",
        "--remove-orphans",
    )
    assert step.limit is not None
    assert step.limit > 120.0


def test_stopping_and_last_words() -> None:
    """Containers are stopped, not removed, and their last lines are asked for without colours."""
    assert compose_steps.stop(PI, "abc").argv[-2:] == ("compose", "stop")
    words = ("compose", "logs", "--no-color", "--no-log-prefix", "--tail", "8")
    assert compose_steps.last_words(PI, "abc").argv[-len(words) :] == words


def test_the_archive_is_one_that_any_tar_reads() -> None:
    """Names only below the release's directory: nothing absolute, nothing that climbs."""
    with tarfile.open(fileobj=io.BytesIO(release().archive())) as archive:
        names = archive.getnames()
    assert sorted(names) == [".env", "compose.override.yaml", "compose.yaml", "files"]
