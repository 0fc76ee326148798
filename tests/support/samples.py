"""Robots, images, releases and facts for tests: complete and unremarkable, so that a test names only what it is about."""

from __future__ import annotations

from fleet.config.inventory import Robot
from fleet.config.stack import Stack
from fleet.images.image import Image
from fleet.robot.facts import Container, Facts
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


def facts(
    *,
    current: str = "",
    releases: tuple[str, ...] = (),
    containers: tuple[Container, ...] = (),
    images: dict[str, str] | None = None,
    history: tuple[str, ...] = (),
    disk_free: int = 20_000_000_000,
) -> Facts:
    """A Raspberry Pi with Docker, on which nothing else was found."""
    return Facts(
        machine="aarch64",
        userland="arm64",
        os="Debian GNU/Linux 13 (trixie)",
        login="pi",
        groups=("pi", "sudo", "docker"),
        sudo="free",
        clock=1_790_000_000.0,
        disk_size=32_000_000_000,
        disk_free=disk_free,
        starts_at_boot=True,
        docker_group=("pi",),
        current=current,
        releases=releases,
        history=history,
        engine="ready",
        docker="28.0.4",
        client="28.0.4",
        store="overlay2",
        compose="2.26.1",
        containers=containers,
        images=images or {},
    )
