"""What should ``/etc/docker/daemon.json`` say on a robot, and which step writes it?

Containers of a robot run for years, and Docker's usual log driver keeps every line: without rotation the SD card fills.
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

# A copy first, so that the file keeps its owner and mode; then a rename, so that a power cut leaves one whole file.
_WRITE = (
    'mkdir -p "$(dirname "$1")" && { [ ! -e "$1" ] || cp -p "$1" "$1.new"; }'
    ' && cat > "$1.new" && mv "$1.new" "$1"'
)


def steps(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    """The step that writes it, if it does not say already what it should; what else it says stays.

    Docker reads it when it starts. It is not restarted for this: that would stop its containers.

    Raises:
        NotReady: what is there is not what Docker can read; it would not start.

    """
    said = _read(facts.docker.daemon_config)
    wanted = _with_rotation(said, size=robot.docker.log_max_size, count=robot.docker.log_max_file)
    if said == wanted:
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
    cure = f"mend it there (`sudo nano {PATH}`), or remove it"
    try:
        said = json.loads(text) if text.strip() else {}
    except ValueError as problem:
        raise NotReady(f"{PATH} is not JSON: {problem}", cure=cure) from None
    if not isinstance(said, dict) or not isinstance(said.get("log-opts", {}), dict):
        raise NotReady(f"{PATH} does not hold settings as Docker reads them", cure=cure)
    return said


def _with_rotation(said: dict[str, Any], *, size: str, count: int) -> dict[str, Any]:
    """``said`` and rotation; unchanged where a person chose another log driver, whose options differ."""
    if said.get("log-driver", "json-file") != "json-file":
        return said
    options = {**said.get("log-opts", {}), "max-size": size, "max-file": str(count)}
    return {**said, "log-driver": "json-file", "log-opts": options}
