"""Does the newest Docker run on a Jetson, and has Docker the runtime that gives containers its GPU?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fleet.errors import NotReady
from fleet.plan.step import Step
from fleet.provision.sudo import as_root

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts

NEEDS_RAW_TABLE = 28
"""From this version on Docker needs the iptables table ``raw`` (moby #49508, #49557)."""

WORKS = "27.5.1"
"""The last version before it."""

RUNTIME = {"args": [], "path": "nvidia-container-runtime"}
"""What ``nvidia-ctk runtime configure`` writes (NVIDIA Container Toolkit 1.11 to 1.18)."""

_PROOF = '{{range $name, $_ := .Runtimes}}{{if eq $name "nvidia"}}nvidia{{end}}{{end}}'


def check_version(robot: Robot, facts: Facts, *, major: int | None) -> None:
    """Refuse a version of Docker that the robot's kernel is not made for; ``major`` is None for the newest.

    A Docker that answers has shown that it starts here. Then a table of which nothing is known refuses nothing.

    Raises:
        NotReady: with the line to write.

    """
    if not facts.hardware.lacks_raw_table or (major is not None and major < NEEDS_RAW_TABLE):
        return
    if facts.hardware.raw_table is None and facts.docker.state in ("ready", "forbidden"):
        return
    board = facts.hardware.model or "robot"
    why = f"without it Docker {NEEDS_RAW_TABLE} and newer do not start, or publish no ports"
    known = (
        "has no iptables table `raw`"
        if facts.hardware.raw_table is False
        else "may have no iptables table `raw`"
    )
    write = f"write `docker: {{version: {WORKS}}}` for {robot.name} in the inventory"
    there = facts.docker.version or facts.docker.client
    remove = "; remove Docker on the robot (its containers stop; images stay)" if there else ""
    have = f"Docker {there} is installed, and the" if there else "the"
    raise NotReady(
        f"{have} kernel of this {board} {known}: {why}",
        cure=f"{write}{remove}; then run the same command again",
    )


def wants_runtime(facts: Facts) -> bool:
    """Whether Docker is to be told of the runtime nvidia: the toolkit is there, and Docker does not have it."""
    return facts.hardware.toolkit and "nvidia" not in facts.docker.runtimes


def with_runtime(settings: dict[str, Any]) -> dict[str, Any]:
    """Docker's settings with the runtime nvidia; one that is there stays as it is."""
    return {**settings, "runtimes": {"nvidia": RUNTIME, **(settings.get("runtimes") or {})}}


def reload(facts: Facts) -> tuple[Step, ...]:
    """Let a Docker that runs read its settings; it does not stop containers for that."""
    if not wants_runtime(facts) or facts.docker.state not in ("ready", "forbidden"):
        return ()
    argv = as_root(facts, "systemctl", "reload", "docker")
    return (Step(title="let Docker read its settings; containers go on running", argv=argv, limit=60.0),)


def proof(facts: Facts) -> tuple[Step, ...]:
    """Prove that Docker has the runtime nvidia, if it was told of it."""
    if not wants_runtime(facts):
        return ()
    argv = ("docker", "info", "--format", _PROOF)
    return (Step(title="prove that Docker has the runtime nvidia", argv=argv, expect="nvidia", limit=30.0),)
