"""How can you try a fleet without owning one? With virtual Pis: containers that boot and behave like computers.

All Docker objects of a lab have the label ``fleet.lab=<name>``, so that they can be found and removed. The lab's folder
holds the SSH key for its Pis and the inventory that lists them.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.errors import DesktopError, UsageError
from fleet.images.docker_cli import docker, docker_or_none
from fleet.images.emulation import desktop_platform, emulates
from fleet.lab.virtual_pi import VirtualPi, ensure_image, run_command

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

RECIPE = Path(__file__).parent / "recipe"
LARGEST = 200  # Pis; their addresses fit into the smallest network Docker hands out
BOOT_TAKES = 120.0  # seconds; one second is usual, a desktop that is busy with many Pis takes longer
NETWORK_TRIES = 5
WANTED = "linux/arm64"
FILES = ("id_ed25519", "id_ed25519.pub", "inventory.yaml", "known_hosts", "known_hosts.old")


def up(
    count: int, *, directory: Path, name: str = "lab", say: Callable[[str], None], recipe: Path = RECIPE
) -> None:
    """Make ``count`` virtual Pis that answer SSH, and an inventory of them in ``directory``.

    Running Pis are left alone, stopped ones are started, missing ones are made. Raises ``UsageError`` for an impossible
    count or name, ``DesktopError`` if this computer lacks something.
    """
    _check_request(count, name)
    _check_engine()
    image = ensure_image(recipe, say=say)
    images = {f"pi{number}": image for number in range(1, count + 1)}
    have(images, directory=directory, name=name, say=say, recipe=recipe)


def have(
    images: Mapping[str, str],
    *,
    directory: Path,
    name: str,
    say: Callable[[str], None],
    recipe: Path = RECIPE,
) -> None:
    """Do the same for Pis with any names, each with its own image: name -> image."""
    _check_request(len(images), name)
    platform = _platform(say=say)
    directory.mkdir(parents=True, exist_ok=True)
    key = _key(directory)
    network = _network(name)
    there = {pi.name: pi for pi in list_(name=name)}
    for number, (pi_name, image) in enumerate(images.items(), start=11):
        blank = VirtualPi(name=pi_name, lab=name, address=str(network[number]), platform=platform)
        _switch_on(there.get(pi_name, blank), image=image, directory=directory, say=say)
    pis = list_(name=name)
    on = tuple(pi for pi in pis if pi.state == "running")
    for pi in on:
        _authorise(pi, key=key)
    for pi in on:
        _await_ssh(pi, key=key)
    write_inventory(pis, directory=directory, platform=platform, recipe=recipe)
    say(f"{len(on)} virtual Pi{'s' * (len(on) != 1)} up: {', '.join(f'{pi.name} {pi.address}' for pi in on)}")


def down(*, directory: Path, name: str = "lab", say: Callable[[str], None]) -> None:
    """Remove the lab's containers, volumes and network, and its files in ``directory``; nothing else."""
    label = f"label=fleet.lab={name}"
    removed = (
        _remove(("rm", "--force", "--volumes"), docker("ps", "--all", "--quiet", "--filter", label)),
        _remove(("volume", "rm"), docker("volume", "ls", "--quiet", "--filter", label)),
        _remove(("network", "rm"), docker("network", "ls", "--quiet", "--filter", label)),
    )
    for file in FILES:
        (directory / file).unlink(missing_ok=True)
    if directory.is_dir() and not any(directory.iterdir()):
        directory.rmdir()
    say(
        f"removed {removed[0]} virtual Pi{'s' * (removed[0] != 1)}"
        if any(removed)
        else "there are no virtual Pis to remove"
    )


def list_(*, name: str = "lab") -> tuple[VirtualPi, ...]:
    """Return the lab's Pis in order, running or not."""
    ids = docker("ps", "--all", "--quiet", "--filter", f"label=fleet.lab={name}").split()
    if not ids:
        return ()
    address = f'{{{{with index .NetworkSettings.Networks "fleet-{name}"}}}}{{{{.IPAMConfig.IPv4Address}}}}{{{{end}}}}'
    lines = docker(
        "inspect", "--format", f"{{{{.Config.Hostname}}}} {{{{.State.Status}}}} {address}", *ids
    ).splitlines()
    platform = WANTED if _arm_runs() else desktop_platform()
    rows = (line.split() for line in lines)
    pis = (
        VirtualPi(name=pi, lab=name, address=address, platform=platform, state=state)
        for pi, state, address in rows
    )
    return tuple(sorted(pis, key=lambda pi: IPv4Address(pi.address)))


def _check_request(count: int, name: str) -> None:
    if not 1 <= count <= LARGEST:
        raise UsageError(f"a lab cannot have {count} Pis", cure=f"choose --count from 1 to {LARGEST}")
    if not re.fullmatch(r"[a-z0-9][a-z0-9-]{0,30}", name):
        raise UsageError(f"a lab cannot be called {name!r}", cure="use lower-case letters, digits and dashes")


def _check_engine() -> None:
    """Refuse Docker Engines whose networks this computer cannot reach."""
    endpoint = os.environ.get("DOCKER_HOST") or docker(
        "context", "inspect", "--format", "{{.Endpoints.docker.Host}}"
    )
    if not endpoint.startswith("unix://"):
        raise _out_of_reach(f"another computer's ({endpoint})")
    info = docker("info", "--format", "{{.OperatingSystem}} {{json .SecurityOptions}}")
    for sign, whose in (("Docker Desktop", "Docker Desktop's"), ("name=rootless", "a rootless one")):
        if sign in info:
            raise _out_of_reach(whose)


def _out_of_reach(whose: str) -> DesktopError:
    return DesktopError(
        f"this computer cannot reach virtual Pis by address, because the Docker Engine in use is {whose}",
        cure="use a Docker Engine on this computer itself: https://docs.docker.com/engine/install",
    )


def _arm_runs() -> bool:
    return desktop_platform() == WANTED or emulates(WANTED)


def _platform(*, say: Callable[[str], None]) -> str:
    """Return the platform of the lab's Pis: ARM like real ones, or the desktop's own if it cannot emulate ARM."""
    if _arm_runs():
        return WANTED
    say(
        f"this computer cannot emulate ARM, so its virtual Pis run {desktop_platform()} (the packages qemu-user-static and binfmt-support set up ARM)"
    )
    return desktop_platform()


def _key(directory: Path) -> Path:
    """Return the lab's SSH key; make it if it is missing."""
    key = directory.resolve() / "id_ed25519"
    if not (key.exists() and key.with_suffix(".pub").exists()):
        key.unlink(missing_ok=True)
        _run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "fleet lab", "-f", str(key))
    return key


def _network(lab: str) -> IPv4Network:
    """Return the lab's network; make it if it is missing. Docker chooses a free subnet; fixed addresses must name it."""
    network, subnet = f"fleet-{lab}", "{{(index .IPAM.Config 0).Subnet}}"
    label = f"fleet.lab={lab}"
    if there := docker_or_none(
        "network", "inspect", "--format", subnet + ' {{index .Labels "fleet.lab"}}', network
    ):
        if there.split()[1:] != [lab]:
            raise DesktopError(
                f"the Docker network {network} exists and does not belong to this lab",
                cure=f"remove it if it is not needed: `docker network rm {network}`",
            )
        return IPv4Network(there.split()[0])
    for tries_left in range(NETWORK_TRIES, 0, -1):
        docker("network", "create", "--label", label, network)
        free = docker("network", "inspect", "--format", subnet, network)
        docker("network", "rm", network)
        try:
            docker("network", "create", "--label", label, "--subnet", free, network)
        except DesktopError:  # another program got the same subnet meanwhile
            if tries_left == 1:
                raise
        else:
            break
    return IPv4Network(free)


def _switch_on(pi: VirtualPi, *, image: str, directory: Path, say: Callable[[str], None]) -> None:
    if pi.state == "running":
        return
    say(f"{pi.name}: making it" if pi.state == "missing" else f"{pi.name}: starting it again")
    if pi.state == "missing":
        _make(pi, image=image, directory=directory)
    else:
        docker("unpause" if pi.state == "paused" else "start", pi.container)


def _make(pi: VirtualPi, *, image: str, directory: Path) -> None:
    """Make a blank Pi: remove the volume and the recorded host key of an old Pi with this name or address."""
    label = f"fleet.lab={pi.lab}"
    if docker_or_none("volume", "inspect", "--format", "{{.Name}}", pi.volume):
        docker("volume", "rm", pi.volume)
    docker("volume", "create", "--label", label, pi.volume)
    if (directory / "known_hosts").exists():
        _run("ssh-keygen", "-R", pi.address, "-f", str(directory / "known_hosts"))
    docker(*run_command(pi, image=image, network=f"fleet-{pi.lab}", labels=(label,)))


def _authorise(pi: VirtualPi, *, key: Path) -> None:
    """Let the lab's key log in as ``pi``."""
    script = (
        "install -d -m 700 -o pi -g pi /home/pi/.ssh && cd /home/pi/.ssh && touch authorized_keys"
        ' && { grep -qxF "$1" authorized_keys || echo "$1" >> authorized_keys; } && chown pi:pi authorized_keys'
    )
    public = key.with_suffix(".pub").read_text().strip()
    docker("exec", pi.container, "sh", "-c", script, "authorise", public)


def _await_ssh(pi: VirtualPi, *, key: Path) -> None:
    """Wait until the user ``pi`` can log in. It is a real login, because sshd blocks addresses that only connect."""
    options = (
        "BatchMode=yes",
        "ConnectTimeout=5",
        "StrictHostKeyChecking=no",
        "UserKnownHostsFile=/dev/null",
    )
    settings = (part for option in options for part in ("-o", option))
    command = ("ssh", "-F", "none", "-i", str(key), *settings, f"pi@{pi.address}", "true")
    deadline = time.monotonic() + BOOT_TAKES
    while (
        done := subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    ).returncode:
        if time.monotonic() > deadline:
            errors = done.stderr.decode(errors="replace").strip().splitlines()
            raise DesktopError(
                f"{pi.name} at {pi.address} does not accept the lab's SSH key after {BOOT_TAKES:g} s: {''.join(errors[-1:])}",
                cure=f"see `docker logs {pi.container}`, and check that no firewall blocks Docker's networks",
            )
        time.sleep(0.3)


def write_inventory(pis: tuple[VirtualPi, ...], *, directory: Path, platform: str, recipe: Path) -> None:
    """Write an inventory of the Pis into ``directory``; the project's inventory can include it."""
    script = os.path.relpath(recipe / "get-docker.sh", directory)
    lines = (
        "# Written by `fab lab.up`, removed by `fab lab.down`. Paths are relative to this file.",
        "known_hosts: known_hosts",
        "defaults:",
        "  user: pi",
        "  identity_file: id_ed25519",
        f"  platform: {platform}",
        # A JSON string is also a YAML string, whatever the path contains.
        f"  docker: {{script: {json.dumps(script)}}}",
        "robots:",
        *(f"  {pi.name}: {{address: {pi.address}}}" for pi in pis),
    )
    (directory / "inventory.yaml").write_text("\n".join(lines) + "\n")


def _remove(command: tuple[str, ...], listed: str) -> int:
    """Remove the listed Docker objects. Returns their number."""
    names = listed.split()
    if names:
        docker(*command, *names)
    return len(names)


def _run(*argv: str) -> None:
    try:
        subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, check=True)
    except FileNotFoundError:
        raise DesktopError(
            f"{argv[0]} is not installed on this computer", cure="install the openssh-client package"
        ) from None
    except subprocess.CalledProcessError as error:
        errors = error.stderr.decode(errors="replace").strip()
        raise DesktopError(f"{argv[0]} failed: {errors}") from None
