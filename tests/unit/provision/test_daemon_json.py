from __future__ import annotations

import json
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Docker, Robot
from fleet.errors import NotReady
from fleet.plan.step import Bytes
from fleet.provision import daemon_json
from fleet.robot.facts import Docker as Engine
from fleet.robot.facts import Facts, Login
from fleet.robot.hardware import Hardware

if TYPE_CHECKING:
    from pathlib import Path

ROBOT = Robot(name="pi1", address="10.0.0.1", docker=Docker(log_max_size="5m", log_max_file=2))


def written(said: str) -> object:
    (step,) = daemon_json.steps(ROBOT, Facts(docker=Engine(daemon_config=said)))
    assert isinstance(step.feed, Bytes)
    return json.loads(step.feed.data)


@pytest.mark.parametrize("said", ["", "\n", "{}"])
def test_rotation_is_set_where_nothing_is(said: str) -> None:
    """Docker's usual driver, which keeps every line for ever without it."""
    assert written(said) == {"log-driver": "json-file", "log-opts": {"max-size": "5m", "max-file": "2"}}


def test_what_is_there_stays() -> None:
    """Other settings are the user's; only the two of rotation are the inventory's."""
    said = {"mtu": 1400, "log-opts": {"max-size": "1g", "labels": "x"}, "dns": ["1.1.1.1"], "größe": "ü"}
    assert written(json.dumps(said)) == {
        **said,
        "log-driver": "json-file",
        "log-opts": {"max-size": "5m", "labels": "x", "max-file": "2"},
    }


def test_nothing_is_written_twice() -> None:
    """What the first run wrote, the second reads and leaves."""
    assert daemon_json.steps(ROBOT, Facts(docker=Engine(daemon_config=json.dumps(written("{}"))))) == ()


def test_another_log_driver_is_a_persons_choice() -> None:
    """Its options differ: Docker would not start with json-file's."""
    assert daemon_json.steps(ROBOT, Facts(docker=Engine(daemon_config='{"log-driver": "journald"}'))) == ()


@pytest.mark.parametrize("said", ["{ bad", "[]", '"x"', '{"log-opts": 1}', '{"a": 1} trailing'])
def test_what_docker_could_not_read_is_refused(said: str) -> None:
    """Docker would not start, and a person's settings must not be thrown away."""
    with pytest.raises(NotReady) as refused:
        daemon_json.steps(ROBOT, Facts(docker=Engine(daemon_config=said)))
    assert "/etc/docker/daemon.json" in refused.value.what
    assert "sudo nano /etc/docker/daemon.json" in refused.value.cure


def test_writing_keeps_the_files_mode(tmp_path: Path) -> None:
    """The step's own shell text, run: whole or not at all, and as private as before."""
    (step,) = daemon_json.steps(ROBOT, Facts(login=Login(sudo="root")))
    assert isinstance(step.feed, Bytes)
    path = tmp_path / "docker" / "daemon.json"
    assert step.argv.count(daemon_json.PATH) == 1  # this computer's own must stay as it is
    argv = tuple(str(path) if word == daemon_json.PATH else word for word in step.argv)
    for mode in (None, 0o600, 0o666):
        if mode:
            path.chmod(mode)
        subprocess.run(argv, input=step.feed.data, check=True)
        assert path.read_bytes() == step.feed.data
    assert path.stat().st_mode & 0o777 == 0o666
    assert sorted(path.parent.iterdir()) == [path, path.with_name("daemon.json.before-fleet")]


def test_the_runtime_nvidia_joins_other_settings() -> None:
    """One write for both; a person's runtimes stay."""
    said = {**json.loads(json.dumps(written("{}"))), "runtimes": {"crun": {"path": "crun"}}}
    toolkit = Hardware(toolkit=True)
    (step,) = daemon_json.steps(ROBOT, Facts(docker=Engine(daemon_config=json.dumps(said)), hardware=toolkit))
    assert step.title == "give Docker the runtime nvidia"
    assert isinstance(step.feed, Bytes)
    runtimes = {"nvidia": {"args": [], "path": "nvidia-container-runtime"}, "crun": {"path": "crun"}}
    assert json.loads(step.feed.data) == {**said, "runtimes": runtimes}
    told = Engine(daemon_config=step.feed.data.decode(), runtimes=("runc",))
    assert daemon_json.steps(ROBOT, Facts(docker=told, hardware=toolkit)) == ()
    with pytest.raises(NotReady):
        daemon_json.steps(ROBOT, Facts(docker=Engine(daemon_config='{"runtimes": []}')))
