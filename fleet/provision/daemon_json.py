"""Steps that write Docker's settings on a robot, ``/etc/docker/daemon.json``: rotated logs, and the runtime nvidia.

A robot's containers run for years, and Docker's default log driver keeps every line: without rotation the SD card fills up.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from fleet.errors import NotReady
from fleet.provision import jetson, whole_file

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.plan.step import Step
    from fleet.robot.facts import Facts

PATH = "/etc/docker/daemon.json"


def steps(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    """The step that adds log rotation, and the runtime nvidia where its toolkit is, to the settings; others stay.

    Docker reads rotation when it starts. It is not restarted for this, because that would stop the robot's containers.

    Raises:
        NotReady: Docker cannot read the file, and would not start.

    """
    present = _read(facts.docker.daemon_config)
    rotated = _with_rotation(present, size=robot.docker.log_max_size, count=robot.docker.log_max_file)
    wanted = jetson.with_runtime(rotated) if jetson.wants_runtime(facts) else rotated
    if present == wanted:
        return ()
    runs = facts.docker.state in ("ready", "forbidden")
    when = ", from the next start of Docker on" if runs else ""
    logs = f"keep {robot.docker.log_max_file} log files of {robot.docker.log_max_size} per container{when}"
    titles = ([logs] if rotated != present else []) + (
        ["give Docker the runtime nvidia"] if wanted != rotated else []
    )
    text = json.dumps(wanted, indent=2, ensure_ascii=False) + "\n"
    return (
        whole_file.step(
            "; ".join(titles), PATH, text.encode(), label=" ".join(text.split()), root=facts, keep=True
        ),
    )


def _read(text: str) -> dict[str, Any]:
    cure = f"fix the file on the robot (`sudo nano {PATH}`), or remove it"
    try:
        settings = json.loads(text) if text.strip() else {}
    except (ValueError, RecursionError) as problem:
        raise NotReady(f"{PATH} is not JSON: {problem}", cure=cure) from None
    if not isinstance(settings, dict) or not all(
        isinstance(settings.get(key, {}), dict) for key in ("log-opts", "runtimes")
    ):
        raise NotReady(f"{PATH} does not have the form that Docker reads", cure=cure)
    return settings


def _with_rotation(settings: dict[str, Any], *, size: str, count: int) -> dict[str, Any]:
    """The settings with log rotation; unchanged with another log driver, whose options differ."""
    if settings.get("log-driver", "json-file") != "json-file":
        return settings
    options = {**settings.get("log-opts", {}), "max-size": size, "max-file": str(count)}
    return {**settings, "log-driver": "json-file", "log-opts": options}
