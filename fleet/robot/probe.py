"""What does the robot have now? The probe that asks in one round trip, and the value its answer becomes.

The probe is a POSIX shell script (``onboard/probe.sh``) that reads and never writes. It answers in sections, each opened by
a line ``MARK name``. A login script may print text before the first one: it would corrupt streams, so it is kept as noise.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from datetime import datetime
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.errors import NotAsPlanned
from fleet.robot import claims, hardware, image_store
from fleet.robot.facts import (
    Container,
    Dev,
    Disk,
    Docker,
    EngineKind,
    EngineState,
    Facts,
    Fleet,
    HomeState,
    Host,
    Login,
    Packages,
    StackFacts,
    Sudo,
)
from fleet.robot.paths import PART

if TYPE_CHECKING:
    from collections.abc import Mapping

MARK = "=fleet="

LONGEST = 1_000_000
"""Bytes of a robot's answer that are read. Ten stacks with a long history have 300 kB."""

LONGEST_WITH_IMAGES = 4_000_000
"""The same with the robot's images: a hundred of twenty layers each have 400 kB."""

_MOST_STACKS, _MOST_CONTAINERS, _MOST_LINES = 200, 2000, 50_000
"""More of them are no robot's: they would fill the memory of this computer."""

_LINES = {
    "daemon",
    "devices",
    "stacks",
    "containers",
    "images",
    "claims",
    "layers",
    "sizes",
    "receipts",
    "pulled",
    "spool",
    "pins",
}
"""Sections with many lines; all others have a few words."""

_SECTION = 10_000
"""Characters of such a section that are read."""

_VERSION = re.compile(r"[0-9][0-9A-Za-z.+~:_-]{0,63}")


def command(*, images: bool = False) -> tuple[str, ...]:
    """The argv that probes a robot; with ``images`` also its layers and transfers, which takes longer."""
    return ("sh", "-c", onboard.text("probe.sh"), "probe", *(["images"] if images else []))


def parse(text: str) -> Facts:
    """Read the probe's answer. A missing or empty section leaves its facts at their defaults.

    Raises:
        NotAsPlanned: it has more in it than any robot.

    """
    _at_most(_MOST_LINES, text.count("\n"), "lines")
    noise, *parts = text.split(f"\n{MARK} ")
    split = (part.partition("\n") for part in parts)
    bodies = {
        name: body.strip("\n") if name in _LINES else body.strip("\n")[:_SECTION] for name, _, body in split
    }
    sections = defaultdict(str, bodies)
    return Facts(
        host=_host(sections),
        login=_login(sections, noise=noise.strip()[:_SECTION]),
        disk=_disks(sections["disk"], sections["home disk"]),
        docker=_docker(sections, there="docker" in bodies),
        packages=Packages(
            installed=tuple(sections["packages"].split()),
            interrupted=bool(sections["interrupted"]),
            docker_source=bool(sections["source"]),
        ),
        hardware=hardware.parse(sections),
        fleet=Fleet(
            stacks=_stacks(
                sections["stacks"], _containers(sections["containers"], _proved(sections["stacks"]))
            ),
            legacy=sections["legacy"],
            images=_images(sections["images"]),
            image_store=image_store.parse(sections),
            claims=claims.parse(sections["claims"]),
        ),
    )


def _at_most(most: int, count: int, what: str) -> None:
    if count > most:
        raise NotAsPlanned(
            f"the robot's answer has {count} {what}, which cannot be",
            cure="log in and see what its shell and its `docker` print",
        )


def _host(sections: Mapping[str, str]) -> Host:
    temperature = _number(sections["temperature"])
    memory = sections["memory"]
    return Host(
        identity=" ".join(sections["identity"].split()),
        machine=sections["machine"],
        userland=sections["userland"],
        os=sections["os"],
        clock=float(_number(sections["clock"]) or 0),
        temperature=None if temperature is None else temperature / 1000,
        memory=int(memory) * 1024 if re.fullmatch("[0-9]{1,15}", memory) else 0,
        emulates=tuple(path.rpartition("/")[2] for path in sections["emulates"].split()),
        missing=tuple(sections["missing"].split()),
    )


def _login(sections: Mapping[str, str], *, noise: str) -> Login:
    name, home, *groups = (*sections["login"].splitlines(), "", "")
    return Login(
        name=name,
        home=home,
        groups=tuple(" ".join(groups).split()),
        sudo=_sudo(sections["sudo"]),
        noise=noise,
        home_state=_home(sections["home"]),
    )


def _docker(sections: Mapping[str, str], *, there: bool) -> Docker:
    """``there``: the robot has a ``docker`` command."""
    state, version = _engine(sections["docker"]) if there else ("absent", "")
    data_root, driver, status = _store(sections["store"])
    words = [line.partition(" ")[::2] for line in sections["engine"].splitlines()]
    return Docker(
        state=state,
        kind=_kind(sections, there=there, state=state, data_root=data_root),
        version=version,
        client=_client(sections["client"]),
        compose=_compose(sections["compose"]),
        data_root=data_root,
        driver=driver,
        containerd="io.containerd.snapshotter.v1" in status,
        members=_members(sections["group"]),
        daemon_config=sections["daemon"],
        finish_unit=_unit(sections["finish"]),
        boot_unit=_unit(sections["boot unit"]),
        starts_at_boot=sections["boot"] == "enabled",
        runtimes=tuple(name for word, name in words if word == "runtime"),
        default_runtime=next((name for word, name in words if word == "default"), ""),
        cdi=bool(sections["specs"]),
    )


def _engine(answer: str) -> tuple[EngineState, str]:
    """The engine's state and version, from the output of ``docker version``."""
    last = "".join(answer.splitlines()[-1:])
    version = last.partition(" ")[0]  # its components follow
    if _VERSION.fullmatch(
        version
    ):  # warnings come before it, such as that of a forbidden ~/.docker/config.json
        return "ready", version
    return ("forbidden" if "permission denied" in answer.lower() else "stopped"), ""


def _kind(sections: Mapping[str, str], *, there: bool, state: EngineState, data_root: str) -> EngineKind:
    """The engine that the ``docker`` command leads to; if it does not answer, the one that is installed."""
    client, answer, engine = sections["client"], sections["docker"], sections["engine"].splitlines()
    # Its shim, its program under Docker's name, and Docker's client on its socket.
    if client.startswith(("podman version", "docker version")) or "Podman Engine" in answer:
        return "podman"
    services = [line for line in engine if line.startswith("there is ")]
    has_package = {"docker-ce", "docker.io"} & set(sections["packages"].split())
    if state == "ready":
        rootless, snap = "name=rootless" in engine, data_root.startswith("/var/snap/")
    else:
        rootless = "unix:///run/user/" in answer or (
            not there and any("/systemd/user/" in s for s in services)
        )
        snap = not has_package and any("/snap/docker/" in service for service in services)
    if rootless:
        return "rootless"
    if snap or "/usr/bin/snap" in engine:
        return "snap"
    return "docker" if there else ""


def _store(line: str) -> tuple[str, str, str]:
    """Data root, driver, and the driver's status; Docker's default root if it does not answer."""
    root, driver, status = (*line.split(" ", 2), "", "", "")[:3]
    return (root, driver, status) if root.startswith("/") else (Docker.data_root, "", "")


def _client(line: str) -> str:
    """``Docker version 26.1.5+dfsg1, build a72d7cd`` -> ``26.1.5+dfsg1``."""
    version = line.removeprefix("Docker version ").partition(",")[0]
    return version if _VERSION.fullmatch(version) else ""


def _unit(answer: str) -> str:
    """The digest of a unit if it is enabled."""
    match answer.split():
        case ["enabled", digest]:
            return digest
        case ["no", "systemd"]:
            return "no systemd"
        case _:
            return ""


def _compose(answer: str) -> str:
    """The plugin's version; "" if ``docker`` printed its own help, as it does without the plugin."""
    version = answer.removeprefix("v")
    return version if _VERSION.fullmatch(version) else ""


def _sudo(word: str) -> Sudo:
    match word:
        case "root" | "free" | "password":
            return word
        case _:
            return "none"


def _home(word: str) -> HomeState:
    match word:
        case "missing" | "foreign":
            return word
        case _:
            return "own"


def _disks(images: str, home: str) -> Disk:
    device, size, free = _file_system(images)
    home_device, _, home_free = _file_system(home)
    return Disk(size=size, free=free, home_free=home_free, shared=not home_device or device == home_device)


def _file_system(table: str) -> tuple[str, int, int]:
    """``df -Pk``: a heading, then one line of POSIX columns in KiB. What tells it from others, size and free bytes."""
    columns = table.splitlines()[-1].split() if table else []
    if len(columns) < 6 or not all(re.fullmatch("[0-9]{1,15}", columns[place]) for place in (1, 3)):
        return "", 0, 0
    return f"{columns[0]} {columns[1]}", int(columns[1]) * 1024, int(columns[3]) * 1024


def _number(text: str) -> int | None:
    return int(text) if re.fullmatch("-?[0-9]{1,15}", text) else None


def _members(line: str) -> tuple[str, ...] | None:
    """The members in a line of ``getent group`` (``docker:x:996:pi,tim``); None if there is no such group."""
    return tuple(filter(None, line.split(":")[3].split(","))) if line.count(":") == 3 else None


def _stacks(text: str, containers: tuple[Container, ...]) -> dict[str, StackFacts]:
    """What each stack has, from lines of a word and its value; a stack whose folder is gone may still have containers."""
    blocks = (block.partition("\n") for block in f"\n{text}".split("\nstack ")[1:])
    lines = {name: body.splitlines() for name, _, body in blocks}
    names = (*lines, *sorted({one.stack for one in containers if one.stack} - lines.keys()))
    _at_most(_MOST_STACKS, len(names), "stacks")
    return {
        name: _stack(lines.get(name, []), [one for one in containers if one.stack == name]) for name in names
    }


def _stack(lines: list[str], containers: list[Container]) -> StackFacts:
    values = defaultdict(list)
    for line in lines:
        word, _, value = line.partition(" ")
        values[word].append(value)
    last = {word: found[-1] for word, found in values.items()}
    data = _number(last.get("data", "0"))
    return StackFacts(
        current=last.get("current", "").rpartition("/")[2],
        checksum=last.get("checksum", ""),
        releases=tuple(name for name in values["release"] if not name.endswith(PART)),
        services=tuple(pair.partition("=")[0] for pair in values["service"]),
        history=tuple(values["event"]),
        containers=tuple(containers),
        data=None if data is None else data * 1024,
        journal=last.get("journal", ""),
        stopped="stopped" in last,
        boot="systemd" if last.get("boot") == "systemd" else "docker",
        dev=_dev(last.get("dev", "")),
    )


def _dev(line: str) -> Dev | None:
    since, _, by = line.partition(" ")
    return Dev(by=by, since=since) if since else None


def _proved(stacks: str) -> frozenset[str]:
    """The IDs of containers whose own check has passed in a swap, which Docker itself may ask for only later."""
    lines = (line.split() for line in stacks.splitlines())
    return frozenset(word for first, *rest in filter(None, lines) if first == "proved" for word in rest)


def _containers(lines: str, proved: frozenset[str]) -> tuple[Container, ...]:
    """One container for each line of JSON; lines that are not JSON are Docker's warnings."""
    _at_most(_MOST_CONTAINERS, lines.count("\n"), "lines about containers")
    return tuple(filter(None, (_container(line, proved) for line in lines.split("\n"))))


_WORDS = (
    "id",
    "name",
    "service",
    "release",
    "stack",
    "robot",
    "state",
    "health",
    "policy",
    "started",
    "ended",
)


def _container(line: str, proved: frozenset[str]) -> Container | None:
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict) or not fields.get("name"):
        return None
    text = {word: _text(fields.get(word)) for word in _WORDS}
    code, restarts = map(_small, (fields.get("code"), fields.get("restarts")))
    return Container(
        name=text["name"].removeprefix("/"),
        service=text["service"],
        release=text["release"],
        stack=text["stack"],
        robot=text["robot"],
        state=text["state"],
        health="healthy" if text["health"] == "starting" and text["id"] in proved else text["health"],
        code=code,
        restarts=restarts,
        policy=text["policy"],
        since=_time(text["started" if text["state"] == "running" else "ended"]),
    )


def _small(number: object) -> int:
    return number if isinstance(number, int) and abs(number) < 1 << 31 else 0


def _text(value: object) -> str:
    """A value of JSON if it is text: that may hold halves of letters, which no terminal and no file takes."""
    return value.encode(errors="replace").decode() if isinstance(value, str) else ""


def _time(text: str) -> float:
    """Docker's time (RFC 3339, nanoseconds), in seconds since the epoch; 0 if there is none."""
    try:
        return datetime.fromisoformat(re.sub(r"\.\d+", "", text)).timestamp()
    except (ValueError, OverflowError):
        return 0.0


def _images(text: str) -> dict[str, str]:
    """The identity of each image by its name: its ID, or what the manifest of that ID names as its configuration."""
    images = {}
    for line in text.splitlines():
        name, _, rest = line.partition(" ")
        match rest.split():
            case [id_, config, receipt] if id_ == f"sha256:{receipt}":
                images[name] = config
            case [id_, *_]:
                images[name] = id_
    return images
