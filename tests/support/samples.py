"""Robots, images, releases and facts for tests: complete and unremarkable, so that a test names only what it is about."""

from __future__ import annotations

from dataclasses import fields, replace

from fleet.config.inventory import Robot
from fleet.config.stack import Stack
from fleet.images.image import Image
from fleet.robot.facts import Container, Disk, Docker, Facts, Host, Login
from fleet.robot.release import Release
from fleet.robot.release import compose as compose_release

PI = Robot(name="pi1", address="pi1.local", user="pi")
TALKER = Image(
    reference="talker:latest-arm64",
    platform="linux/arm64",
    size=241_000_000,
    identity="linux/arm64\nlayer sha256:aa\ncmd roslaunch\nuser ros\ndirectory",
)
STACK = Stack(
    name="talker", text="services:\n  talker:\n    image: talker\n", images={"talker": "talker"}, builds={}
)


def release(*, robot: Robot = PI, stack: Stack = STACK, image: Image = TALKER) -> Release:
    """What ``robot`` runs of ``stack``, all of it from one image."""
    return compose_release(robot=robot, stack=stack, find=lambda _name, _platform: image)


def container(of: str, *, service: str = "talker", state: str = "running", status: str = "") -> Container:
    """A container of release ``of``; a running one is healthy."""
    said = status or ("Up 3 minutes (healthy)" if state == "running" else "Exited (1) 5 seconds ago")
    return Container(
        name=f"talker-{service}-1", service=service, release=of, stack=STACK.name, state=state, status=said
    )


def change(seen: Facts, **values: object) -> Facts:
    """The same facts with other values: ``current="abc"``, ``docker_version="28.0.4"``.

    A value is named by its field, or by its section and its field where the field alone says too little.
    """
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
        host=Host(
            machine="aarch64", userland="arm64", os="Debian GNU/Linux 13 (trixie)", clock=1_790_000_000.0
        ),
        login=Login(name="pi", groups=("pi", "sudo", "docker"), sudo="free"),
        disk=Disk(size=32_000_000_000, free=20_000_000_000),
        docker=Docker(
            state="ready",
            version="28.0.4",
            client="28.0.4",
            compose="2.26.1",
            driver="overlay2",
            members=("pi",),
            starts_at_boot=True,
        ),
    )
    return change(pi, **values)
