"""Robots, images, releases and facts for tests: complete and unremarkable, so that a test names only what it is about."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from fleet.config.compose import LEVELS, Project, Resolved
from fleet.config.inventory import Robot
from fleet.config.project_files import ProjectFiles
from fleet.config.stack import Stack, read
from fleet.images.image import Image
from fleet.robot.facts import Container, Disk, Docker, Facts, Host, Login, StackFacts
from fleet.robot.release import Release
from fleet.robot.release import compose as compose_release

NOW = 1_790_000_000.0
"""The robot's clock, in seconds since the epoch."""

PI = Robot(name="pi1", address="pi1.local", user="pi")
TALKER = Image(
    reference="talker:latest-arm64",
    platform="linux/arm64",
    size=241_000_000,
    identity=f"sha256:{'a1' * 32}",
    layers=("sha256:aa",),
)
PROJECT = Project(
    files=(Path("talker/compose.yaml"),),
    real=Path("/home/tim/talker"),
    folder=Path("/tmp/t").joinpath(*["up"] * LEVELS, "talker"),
)


def stack(**services: dict[str, Any]) -> Stack:
    """A stack with the name ``talker`` and these services, each as Compose's canonical model has it."""
    return read(Resolved(model={"name": "talker", "services": services}), PROJECT)


STACK = stack(talker={"image": "talker", "restart": "unless-stopped"})


def release(*, robot: Robot = PI, of: Stack = STACK, image: Image = TALKER) -> Release:
    """What ``robot`` runs of a stack, all of it from one image."""
    images = dict.fromkeys(of.services, image)
    return compose_release(robot=robot.name, stack=of, project=PROJECT, files=ProjectFiles(), images=images)


def container(
    of: str,
    *,
    service: str = "talker",
    state: str = "running",
    health: str = "healthy",
    **values: Any,  # noqa: ANN401  whatever a container has
) -> Container:
    """A container of release ``of``; a running one has been healthy for three minutes."""
    return Container(
        name=f"talker-{service}-1",
        service=service,
        release=of,
        stack=STACK.name,
        state=state,
        **{
            "robot": "pi1",
            "health": health if state == "running" else "",
            "code": 0 if state == "running" else 1,
            "policy": "unless-stopped",
            "since": NOW - 180,
            **values,
        },
    )


def change(seen: Facts, **values: object) -> Facts:
    """The same facts with other values: ``current="abc"``, ``docker_version="28.0.4"``.

    A value is named by its field, or by its section and its field where the field alone says too little. Those of a stack
    (``current``, ``releases``, ``containers``, ...) are about the stack ``talker``.
    """
    of_stack = {field.name for field in fields(StackFacts)} & values.keys()
    if of_stack:
        talker = seen.fleet.stacks.get(STACK.name, StackFacts())
        talker = replace(talker, **{name: values.pop(name) for name in of_stack})  # type: ignore[arg-type]
        stacks = {**seen.fleet.stacks, STACK.name: talker}
        seen = replace(seen, fleet=replace(seen.fleet, stacks=stacks))
    for section in fields(seen):
        part = getattr(seen, section.name)
        names = {
            name: field.name
            for field in fields(part)
            for name in (field.name, f"{section.name}_{field.name}")
        }
        new = {names[name]: values.pop(name) for name in list(values) if name in names}
        seen = replace(seen, **{section.name: replace(part, **new)})
    assert not values, f"no such facts: {', '.join(values)}"
    return seen


def facts(**values: object) -> Facts:
    """A Raspberry Pi with Docker, on which nothing else was found, but for what ``values`` `change`."""
    pi = Facts(
        host=Host(machine="aarch64", userland="arm64", os="Debian GNU/Linux 13 (trixie)", clock=NOW),
        login=Login(name="pi", home="/home/pi", groups=("pi", "sudo", "docker"), sudo="free"),
        disk=Disk(size=32_000_000_000, free=20_000_000_000),
        docker=Docker(
            state="ready",
            version="28.0.4",
            client="28.0.4",
            compose="2.26.1",
            driver="overlay2",
            members=("pi",),
            starts_at_boot=True,
            finish_unit="0" * 64,
        ),
    )
    return change(pi, **values)
