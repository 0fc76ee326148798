"""What does the robot have now? The probe that asks in one round trip, and the value its answer becomes.

The probe is a POSIX shell script that looks and never touches. It answers in sections, each opened by a line
``MARK name``; whatever a login script prints before the first one is noticed (it would corrupt streams) and left out.
"""

from __future__ import annotations

import json
import re

from fleet.images.identity import IDENTITY
from fleet.robot import image_store
from fleet.robot.facts import Container, Engine, Facts, Sudo
from fleet.robot.paths import PART

MARK = "=fleet="

PROBE = r"""
section() { printf '\n%s %s\n' '=fleet=' "$1"; }
section machine; uname -m
section userland; dpkg --print-architecture 2>/dev/null || getconf LONG_BIT 2>/dev/null
section os; . /etc/os-release 2>/dev/null; printf '%s\n' "${PRETTY_NAME:-unknown}"
section login; id -un; id -Gn
section sudo; if [ "$(id -u)" = 0 ]; then echo root; elif ! command -v sudo >/dev/null; then echo none
  elif sudo -n true 2>/dev/null; then echo free; else echo password; fi
section clock; date +%s
info=; ! command -v docker >/dev/null || info=$(docker info --format \
  '{{.DockerRootDir}} {{.Driver}}{{range .DriverStatus}} {{index . 1}}{{end}}' 2>/dev/null)
root=${info%% *}; case $info in *io.containerd.snapshotter*) root=/var/lib/containerd; esac
section disk; df -Pk "${root:-/var/lib/docker}" 2>/dev/null || df -Pk /var/lib
section store; printf '%s\n' "$info"
section temperature; cat /sys/class/thermal/thermal_zone0/temp 2>/dev/null
section emulates; grep -l '^enabled' /proc/sys/fs/binfmt_misc/qemu-* 2>/dev/null
section boot; systemctl is-enabled docker 2>/dev/null
section daemon; cat /etc/docker/daemon.json 2>/dev/null || sudo -n cat /etc/docker/daemon.json 2>/dev/null
section packages; dpkg-query -W -f '${db:Status-Abbrev}${Package}\n' docker-ce docker.io docker-buildx \
  docker-compose docker-compose-v2 zstd 2>/dev/null | sed -n 's/^ii *//p'
section interrupted; ls /var/lib/dpkg/updates 2>/dev/null
  grep -E '^Status: .* (half-configured|half-installed|unpacked)$' /var/lib/dpkg/status 2>/dev/null
section source; ls /etc/apt/sources.list.d/docker.list 2>/dev/null
section group; getent group docker
section current; readlink "$HOME/.fleet/current" 2>/dev/null
section checksum; cd "$HOME/.fleet/current" 2>/dev/null && find . -type f -print | LC_ALL=C sort |
  tr '\n' '\0' | xargs -0 -r sha256sum | sha256sum | cut -c1-64; cd
section releases; ls -1 "$HOME/.fleet/releases" 2>/dev/null
section history; tail -n 200 "$HOME/.fleet/history" 2>/dev/null
if command -v docker >/dev/null; then
  section docker; docker version --format '{{.Server.Version}}' 2>&1
  section client; docker --version 2>/dev/null
  section compose; docker compose version --short 2>/dev/null
  section containers; docker ps -a --no-trunc --filter label=fleet.release --format '{{json .}}' 2>/dev/null
  section images
  docker image ls --format '{{.Repository}}:{{.Tag}}' 2>/dev/null | grep ':fleet-' | while read -r name; do
    printf 'image %s\n' "$name"; docker image inspect --format 'IDENTITY' "$name" 2>/dev/null; done
fi
""".replace("IDENTITY", IDENTITY)

END = "section end"


def probe(*, images: bool = False) -> str:
    """The script that asks a robot; with ``images`` also for what it holds of them, which takes longer."""
    return "\n".join((PROBE, *([image_store.PROBE] if images else []), END, ""))


def parse(text: str) -> Facts:
    """Read the probe's answer. Sections that are missing or empty leave their facts at the defaults."""
    noise, *parts = text.split(f"\n{MARK} ")
    said = {name: body.strip("\n") for name, _, body in (part.partition("\n") for part in parts)}
    login, *groups = said.get("login", "").splitlines() or [""]
    engine, version = _engine(said.get("docker"))
    store = _store(said.get("store", ""))
    size, free = _disk(said.get("disk", ""))
    temperature = _number(said.get("temperature", ""))
    return Facts(
        machine=said.get("machine", ""),
        userland=said.get("userland", ""),
        os=said.get("os", ""),
        login=login,
        groups=tuple(" ".join(groups).split()),
        sudo=_sudo(said.get("sudo", "")),
        clock=float(_number(said.get("clock", "")) or 0),
        disk_size=size,
        disk_free=free,
        temperature=None if temperature is None else temperature / 1000,
        emulates=tuple(path.rpartition("/")[2] for path in said.get("emulates", "").split()),
        starts_at_boot=said.get("boot", "") == "enabled",
        daemon_config=said.get("daemon", ""),
        docker_group=_members(said.get("group", "")),
        packages=tuple(said.get("packages", "").split()),
        interrupted=bool(said.get("interrupted", "")),
        docker_source=bool(said.get("source", "")),
        current=said.get("current", "").rpartition("/")[2],
        checksum=said.get("checksum", ""),
        releases=tuple(name for name in said.get("releases", "").split() if not name.endswith(PART)),
        history=tuple(said.get("history", "").splitlines()),
        engine=engine,
        docker=version,
        client=_client(said.get("client", "")),
        data_root=store[0],
        store=store[1],
        containerd="io.containerd.snapshotter.v1" in store[2],
        compose=_compose(said.get("compose", "")),
        containers=_containers(said.get("containers", "")),
        images=_images(said.get("images", "")),
        stock=image_store.parse(said),
        noise=noise.strip(),
    )


def _engine(said: str | None) -> tuple[Engine, str]:
    if said is None:  # there is no `docker` command
        return "absent", ""
    last = "".join(said.splitlines()[-1:])
    if last[:1].isdigit():  # warnings come before it, also of a forbidden ~/.docker/config.json
        return "ready", last
    return ("forbidden" if "permission denied" in said.lower() else "stopped"), ""


def _store(said: str) -> tuple[str, str, str]:
    """Data root, driver, and what the driver tells of itself; the usual root where Docker does not answer."""
    root, driver, status = (*said.split(" ", 2), "", "", "")[:3]
    return (root, driver, status) if root.startswith("/") else (Facts.data_root, "", "")


def _client(said: str) -> str:
    """``Docker version 26.1.5+dfsg1, build a72d7cd`` -> ``26.1.5+dfsg1``."""
    return said.removeprefix("Docker version ").partition(",")[0] if said.startswith("Docker version") else ""


def _compose(said: str) -> str:
    """Its version; "" where ``docker`` without the plugin answered with its own help."""
    version = said.removeprefix("v")
    return version if version[:1].isdigit() else ""


def _sudo(said: str) -> Sudo:
    match said:
        case "root" | "free" | "password":
            return said
        case _:
            return "none"


def _disk(said: str) -> tuple[int, int]:
    """``df -Pk``: a heading, then one line of POSIX columns in KiB."""
    columns = said.splitlines()[-1].split() if said else []
    if len(columns) < 4 or not (columns[1].isdigit() and columns[3].isdigit()):
        return 0, 0
    return int(columns[1]) * 1024, int(columns[3]) * 1024


def _number(said: str) -> int | None:
    return int(said) if re.fullmatch("-?[0-9]+", said) else None


def _members(said: str) -> tuple[str, ...] | None:
    """A line of ``getent group``: ``docker:x:996:pi,tim``; None where there is no such group."""
    return tuple(filter(None, said.split(":")[3].split(","))) if said.count(":") == 3 else None


def _containers(said: str) -> tuple[Container, ...]:
    """One JSON object a line; Docker's warnings are none."""
    return tuple(filter(None, map(_container, said.splitlines())))


def _container(line: str) -> Container | None:
    try:
        said = json.loads(line)
    except ValueError:
        return None
    if not isinstance(said, dict) or not said.keys() >= {"Labels", "Names", "State", "Status"}:
        return None
    labels = dict(pair.partition("=")[::2] for pair in said["Labels"].split(","))
    return Container(
        name=said["Names"],
        service=labels.get("com.docker.compose.service", ""),
        release=labels.get("fleet.release", ""),
        stack=labels.get("fleet.stack", ""),
        state=said["State"],
        status=said["Status"],
    )


def _images(said: str) -> dict[str, str]:
    blocks = (block.partition("\n") for block in f"\n{said}".split("\nimage ")[1:])
    return {name: identity.strip() for name, _, identity in blocks}
