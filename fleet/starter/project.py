"""Which files does a new project get? From the answers of a person and the packages of a folder, without effects.

The templates beside this module hold ``@PLACES@`` for values.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

from fleet.config import validation
from fleet.config.inventory import json_schema
from fleet.config.selection import did_you_mean
from fleet.errors import UsageError
from fleet.platforms import NAMES as PLATFORMS
from fleet.platforms import PLATFORM_OF_MACHINE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from fleet.starter.packages import Package

DISTROS: Mapping[str, int] = {"noetic": 1, "humble": 2, "jazzy": 2, "kilted": 2, "rolling": 2}
"""ROS distributions that have an official image, and their generation."""

USUAL = {1: "noetic", 2: "jazzy"}
"""The distribution of each generation that is taken if nobody names one: the last with long support."""

COMPOSE_FILES = ("compose.yaml", "compose.yml", "docker-compose.yaml", "docker-compose.yml")
"""Names of a Compose file that `docker compose` finds by itself."""

COMPOSE_FOLDERS = ("", "docker/", ".docker/", "deploy/")
"""Folders of a project in which people keep it."""

_PLATFORMS_OF_ROS_2 = "linux/arm64 or linux/amd64"


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a person says about a new project: robots' names and addresses, platform, login, ROS distribution.

    ``user`` and ``distro`` may be "".
    """

    robots: Mapping[str, str]
    platform: str = "linux/arm64"
    user: str = ""
    distro: str = ""


@dataclass(frozen=True, kw_only=True)
class Draft:
    """The files of a new project, by name, and what a person should know about them."""

    files: Mapping[str, str]
    notes: tuple[str, ...] = ()


def robots(text: str) -> dict[str, str]:
    """Read ``pi1=192.168.1.11,pi2=pi2.local``; without a name, a robot is called by the first part of its address.

    Raises:
        UsageError: a name or an address is not one, or a name is there twice.

    """
    found: dict[str, str] = {}
    for item in filter(None, (part.strip() for part in text.split(","))):
        name, _, address = (part.strip() for part in item.rpartition("="))
        name = name or (
            f"robot{len(found) + 1}" if re.fullmatch(r"[\d.]+|.*:.*", address) else address.partition(".")[0]
        )
        for pattern, value in ((validation.NAME, name), (validation.ADDRESS, address)):
            if not re.match(pattern, value):
                raise UsageError(
                    f"--robots: {value or item!r} {validation.not_like(pattern, value)}",
                    cure="--robots pi1=192.168.1.11,pi2=pi2.local",
                )
        if name in found:
            raise UsageError(f"--robots names {name} twice", cure="give each robot a name of its own")
        found[name] = address
    return found


def check(request: Request) -> None:
    """Refuse what no project can have.

    Raises:
        UsageError: no such platform or distribution, or not a login.

    """
    if request.platform not in PLATFORMS:
        hint = did_you_mean(PLATFORM_OF_MACHINE.get(request.platform, request.platform), PLATFORMS)
        raise UsageError(
            f"there is no platform {request.platform}", cure=hint or f"there are: {', '.join(PLATFORMS)}"
        )
    if request.distro and request.distro not in DISTROS:
        hint = did_you_mean(request.distro, DISTROS)
        raise UsageError(
            f"fleet knows no ROS distribution {request.distro}",
            cure=hint or f"it knows: {', '.join(DISTROS)}",
        )
    if request.user and not re.match(validation.USER, request.user):
        raise UsageError(f"--user: {request.user!r} {validation.not_like(validation.USER, request.user)}")


def draft(request: Request, *, packages: Sequence[Package], folder: str, there: Sequence[str]) -> Draft:
    """Return the files for a folder of that name, which has the files ``there``, some of them in its folders.

    A Compose file that is there is used, and then no Dockerfile is needed.

    Raises:
        UsageError: the packages cannot be built together, or not for this platform.

    """
    places = (folder + name for folder in COMPOSE_FOLDERS for name in COMPOSE_FILES)
    compose = next((place for place in places if place in there), "")
    ros = 2 if _is_ros_2(request, packages) else 1
    files = {"inventory.yaml": _inventory(request, stack=compose or "compose.yaml", ros=ros)}
    files["inventory.schema.json"] = json.dumps(json_schema(), indent=2) + "\n"
    if compose:
        note = f"{compose} is the stack, as it is: no Compose file and no Dockerfile are written"
        return Draft(files=files, notes=(note,))
    stack = _stack(request, packages, folder, own="Dockerfile" in there)
    return Draft(files={**files, **stack.files}, notes=stack.notes)


def _is_ros_2(request: Request, packages: Sequence[Package]) -> bool:
    if request.distro:
        return DISTROS[request.distro] == 2
    return bool(packages) and all(2 in package.ros for package in packages)


def _inventory(request: Request, *, stack: str, ros: int) -> str:
    domain = "  # Robots of one ROS domain hear each other: 0 to 101.\n  ros: {version: 2, domain: 0}"
    login = f"  # The login.\n  user: {_scalar(request.user)}"
    usual = "  # The login. Left out: what your OpenSSH configuration says.\n  #user: pi"
    lines = [f"  {_scalar(name)}: {_scalar(address)}" for name, address in request.robots.items()]
    return _filled(
        "inventory.yaml",
        STACK=stack,
        USER=login if request.user else usual,
        PLATFORM=request.platform,
        ROS=domain if ros == 2 else "  # ROS 1 is the default. For ROS 2: `ros: {version: 2}`.",
        ROBOTS="\n".join(lines or ["  #pi1: 192.168.1.11", "  #pi2: pi2.local"]),
    )


def _scalar(text: str) -> str:
    """Text as YAML; quoted, unless it is surely read as text without."""
    plain = re.fullmatch(r"[A-Za-z][A-Za-z0-9]*[0-9.-][A-Za-z0-9.-]*|\d+\.\d+\.\d+\.\d+", text)
    return text if plain else json.dumps(text)


def _stack(request: Request, packages: Sequence[Package], folder: str, *, own: bool) -> Draft:
    """The Compose file, the Dockerfile and .dockerignore; ``own``: the folder has a Dockerfile."""
    name = _name(packages[0].name if len(packages) == 1 else folder)
    if not packages:
        build = (
            "" if own else "      args:\n        RUN_BASE: ${FLEET_DEBIAN_BOOKWORM:-debian:bookworm-slim}\n"
        )
        text = _filled("compose.yaml", NAME=name, BUILD=build, COMMAND="", ROS="", MORE="")
        files = {"compose.yaml": text, "Dockerfile": _filled("plain.Dockerfile")}
        note = (
            "no ROS package was found here; `fleet init --example` in an empty folder writes one that talks"
        )
        return Draft(files={**files, ".dockerignore": _filled("folder.dockerignore")}, notes=(note,))
    ros, distro = _distribution(request, packages)
    commands = _commands(packages, ros)
    alone = ros == 1 and not any(package.launches for package in packages)
    text = _filled(
        "compose.yaml",
        NAME=name,
        BUILD="",
        COMMAND=_command(commands, own=own),
        ROS=_filled(f"ros{ros}.yaml"),
        MORE=_filled("roscore.yaml", NAME=name) if alone and not own else "",
    )
    dockerfile = _filled(f"ros{ros}.Dockerfile", DISTRO=distro, NAME=name, COPY="\n".join(_copies(packages)))
    files = {"compose.yaml": text, "Dockerfile": dockerfile, ".dockerignore": _ignore(packages)}
    return Draft(files=files, notes=(*_found(packages, distro), *_choice(commands, own=own)))


def _filled(template: str, **values: str) -> str:
    text = (resources.files(__package__) / "templates" / template).read_text(encoding="utf-8")
    for place, value in values.items():
        text = text.replace(f"@{place}@", value)
    return text.rstrip("\n") + "\n"


def _name(text: str) -> str:
    """Turn a name into one for a Compose project and an image."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "robot"


def _distribution(request: Request, packages: Sequence[Package]) -> tuple[int, str]:
    """Return the generation of ROS, 1 or 2, and the distribution."""
    wanted = {DISTROS[request.distro]} if request.distro else {1, 2}
    for package in packages:
        if not wanted & package.ros:
            other = request.distro or f"another package, of ROS {min(wanted)}"
            raise UsageError(
                f"the package {package.folder} is of ROS {min(package.ros)} and cannot be built with {other}",
                cure=f"put an empty file {'CATKIN_IGNORE' if 1 in package.ros else 'COLCON_IGNORE'} into {package.folder} to leave it out",
            )
        wanted &= package.ros
    ros = max(wanted)
    distro = request.distro or USUAL[ros]
    if ros == 2 and request.platform == "linux/arm/v7":
        raise UsageError(
            f"there is no image of ROS 2 {distro} for {request.platform}",
            cure=f"use a 64-bit system on the robots: --platform {_PLATFORMS_OF_ROS_2}",
        )
    return ros, distro


def _commands(packages: Sequence[Package], ros: int) -> list[tuple[str, ...]]:
    """The commands that may start the robot, the likeliest first: launch files, those of a bringup before others."""
    tools = {1: (("roslaunch",), ("rosrun",)), 2: (("ros2", "launch"), ("ros2", "run"))}[ros]
    likely = sorted(packages, key=lambda package: "bringup" not in package.name)
    launches = [(*tools[0], package.name, launch) for package in likely for launch in package.launches]
    programs = [(*tools[1], package.name, program) for package in likely for program in package.programs]
    return launches + programs


def _command(commands: Sequence[tuple[str, ...]], *, own: bool) -> str:
    """The lines of the Compose file that start the first command, and name the others."""
    if own:
        return ""
    if not commands:
        message = "no command yet: write it into compose.yaml"
        return f"    # Write here what starts your nodes.\n    command: {json.dumps(['bash', '-c', f'echo {message}; exit 1'])}\n"
    others = [f"    #   {' '.join(command)}\n" for command in commands[1:10]]
    also = "".join(["    # Also found here:\n", *others]) if others else ""
    return f"    command: {json.dumps(commands[0])}\n{also}"


def _copies(packages: Sequence[Package]) -> Iterator[str]:
    for top in _tops(packages):
        itself = next((package.name for package in packages if package.folder == top), "")
        target = f"/ws/src/{itself}" if itself else "/ws/src" if top == "src" else f"/ws/src/{top}"
        yield f"COPY {json.dumps([top, target])}"


def _tops(packages: Sequence[Package]) -> tuple[str, ...]:
    """The folders of the first level that hold packages, or "." if the folder itself is one."""
    tops = tuple(dict.fromkeys(package.folder.partition("/")[0] for package in packages))
    for top in tops:
        if re.search(r"[^\w .+@-]", top):
            raise UsageError(f"the folder {top} has a name that a Dockerfile cannot hold", cure="rename it")
    return tops


def _ignore(packages: Sequence[Package]) -> str:
    tops = _tops(packages)
    if "." in tops:
        return _filled("folder.dockerignore")
    return _filled("packages.dockerignore", ALLOWED="\n".join(f"!{top}" for top in tops))


def _found(packages: Sequence[Package], distro: str) -> Iterator[str]:
    names = [package.name for package in packages]
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    yield f"found {len(names)} ROS package{'s' * (len(names) != 1)}: {', '.join(names[:5])}{more}; built with ROS {distro}"


def _choice(commands: Sequence[tuple[str, ...]], *, own: bool) -> Iterator[str]:
    if own:
        return
    if not commands:
        yield "no launch file and no program was found: write `command:` into compose.yaml"
    else:
        yield f"the robots will run: {' '.join(commands[0])}"
