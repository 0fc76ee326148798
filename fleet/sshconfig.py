"""How does OpenSSH's configuration say a robot is reached? One question to ``ssh -G``, which knows every keyword.

Fabric and Paramiko read a part of ``ssh_config(5)`` only (no Include, HostKeyAlias, IdentitiesOnly); ``ssh -G`` prints
what OpenSSH itself would use.
"""

from __future__ import annotations

import getpass
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.errors import DesktopError, Unreachable
from fleet.hostkeys import host_name

if TYPE_CHECKING:
    from fleet.inventory import Robot


@dataclass(frozen=True, kw_only=True)
class Destination:
    """Where a connection goes, as whom, and how it proves itself.

    ``jumps`` are the hosts of ProxyJump in order, each as the user wrote it. ``known_as`` is the name that
    ``known_hosts`` files keep it under: HostKeyAlias where there is one. ``identity_files`` exist. ``known_hosts`` are the user's and the system's files.
    """

    host: str
    port: int
    user: str
    known_as: str
    identity_files: tuple[Path, ...] = ()
    agent: bool = True
    jumps: tuple[str, ...] = ()
    proxy_command: str = ""
    known_hosts: tuple[Path, ...] = ()


def resolve(robot: Robot) -> Destination:
    """Ask OpenSSH how it would reach the robot; what the inventory says comes before what the configuration says.

    Raises:
        DesktopError: there is no ``ssh`` on this computer.
        Unreachable: OpenSSH refuses its own configuration.

    """
    return ask(_options(robot), robot.address)


def login(robot: Robot) -> tuple[str, ...]:
    """The argv of OpenSSH's own client for a robot, with the keys that `fab trust` recorded and no others asked for."""
    known = " ".join(str(path) for path in (robot.known_hosts, *resolve(robot).known_hosts))
    trusted = ("-o", f"UserKnownHostsFile={known}", "-o", "StrictHostKeyChecking=yes")
    return ("ssh", *_options(robot), *trusted, "--", robot.address)


def ask(options: tuple[str, ...], address: str) -> Destination:
    """``ssh -G`` for one address; errors as for `resolve`."""
    try:
        answer = subprocess.run(
            ("ssh", "-G", *options, "--", address), capture_output=True, text=True, check=False, timeout=10
        )
    except FileNotFoundError as problem:
        raise DesktopError("OpenSSH's client is missing", cure="install openssh-client") from problem
    except subprocess.TimeoutExpired as problem:
        raise Unreachable("`ssh -G` hangs", cure="look for a Match exec in ~/.ssh/config") from problem
    if answer.returncode:
        said = answer.stderr.strip().splitlines()[-1:] or ["no reason given"]
        raise Unreachable(f"OpenSSH's configuration is refused: {said[0]}", cure="mend ~/.ssh/config")
    return parse(answer.stdout)


def _options(robot: Robot) -> tuple[str, ...]:
    user = ("-l", robot.user) if robot.user else ()
    port = ("-p", str(robot.port)) if robot.port else ()
    # IdentitiesOnly: a robot that is given a key is not offered every key of the agent (MaxAuthTries).
    key = ("-i", str(robot.identity_file), "-o", "IdentitiesOnly=yes") if robot.identity_file else ()
    return (*user, *port, *key)


def parse(text: str) -> Destination:
    """Read the output of ``ssh -G``: lower-case keywords, one a line, some more than once."""
    said: dict[str, list[str]] = {}
    for line in text.splitlines():
        keyword, _, value = line.partition(" ")
        said.setdefault(keyword, []).append(value)
    one = {keyword: values[0] for keyword, values in said.items()}
    jump, command = one.get("proxyjump", "none"), one.get("proxycommand", "none")
    files = (Path(name).expanduser() for name in said.get("identityfile", []))
    known = " ".join(said.get("userknownhostsfile", []) + said.get("globalknownhostsfile", []))
    return Destination(
        host=one["hostname"],
        port=int(one["port"]),
        user=one.get("user", getpass.getuser()),
        known_as=one.get("hostkeyalias") or host_name(one["hostname"].lower(), int(one["port"])),
        identity_files=tuple(file for file in files if file.is_file()),
        agent=one.get("identityagent") != "none" and one.get("identitiesonly") != "yes",
        jumps=() if jump == "none" else tuple(jump.split(",")),
        proxy_command="" if command == "none" else command,
        known_hosts=tuple(Path(name).expanduser() for name in known.split()),
    )
