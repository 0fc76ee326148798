"""Steps that write Docker's settings on a robot, ``/etc/docker/daemon.json``, to rotate the logs of containers.

A robot's containers run for years, and Docker's default log driver keeps every line: without rotation the SD card fills up.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from fleet.errors import NotReady
from fleet.plan.step import Bytes, Step
from fleet.provision.sudo import as_root

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts

PATH = "/etc/docker/daemon.json"

# The copy keeps the file's owner and mode; the rename leaves one complete file when the power fails.
_WRITE = (
    'mkdir -p "$(dirname "$1")" && { [ ! -e "$1" ] || cp -p "$1" "$1.new"; }'
    ' && cat > "$1.new" && mv "$1.new" "$1"'
)


def steps(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    """The step that adds log rotation to the settings, unless they have it; other settings stay.

    Docker reads the file when it starts. It is not restarted for this, because that would stop the robot's containers.

    Raises:
        NotReady: Docker cannot read the file, and would not start.

    """
    present = _read(facts.docker.daemon_config)
    wanted = _with_rotation(present, size=robot.docker.log_max_size, count=robot.docker.log_max_file)
    if present == wanted:
        return ()
    runs = facts.docker.state in ("ready", "forbidden")
    when = ", from the next start of Docker on" if runs else ""
    text = json.dumps(wanted, indent=2, ensure_ascii=False) + "\n"
    return (
        Step(
            title=f"keep {robot.docker.log_max_file} log files of {robot.docker.log_max_size} per container{when}",
            argv=as_root(facts, "sh", "-c", _WRITE, "sh", PATH),
            feed=Bytes(label=" ".join(text.split()), data=text.encode()),
            limit=20.0,
        ),
    )


def _read(text: str) -> dict[str, Any]:
    cure = f"fix the file on the robot (`sudo nano {PATH}`), or remove it"
    try:
        settings = json.loads(text) if text.strip() else {}
    except (ValueError, RecursionError) as problem:
        raise NotReady(f"{PATH} is not JSON: {problem}", cure=cure) from None
    if not isinstance(settings, dict) or not isinstance(settings.get("log-opts", {}), dict):
        raise NotReady(f"{PATH} does not have the form that Docker reads", cure=cure)
    return settings


def _with_rotation(settings: dict[str, Any], *, size: str, count: int) -> dict[str, Any]:
    """The settings with log rotation; unchanged with another log driver, whose options differ."""
    if settings.get("log-driver", "json-file") != "json-file":
        return settings
    options = {**settings.get("log-opts", {}), "max-size": size, "max-file": str(count)}
    return {**settings, "log-driver": "json-file", "log-opts": options}
