"""How does OpenSSH's configuration reach a robot? ``ssh -G`` answers, because it knows every keyword.

Fabric and Paramiko read a part of ``ssh_config(5)`` only (no Include, HostKeyAlias, IdentitiesOnly); ``ssh -G`` prints
the values that OpenSSH uses. Only the tokens of some values (``%h``) are replaced here.
"""

from __future__ import annotations

import os
import pwd
import re
import socket
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.errors import DesktopError, Unreachable
from fleet.ssh.known_hosts import host_name

if TYPE_CHECKING:
    from fleet.config.inventory import Robot

_MOST_HOPS = 8

_WATCHED = ("ConnectTimeout=10", "ServerAliveInterval=8", "ServerAliveCountMax=3")
"""How OpenSSH's own client notices a dead link about as soon as our verbs do (`fleet.ssh.connect.LINK_TIMEOUT`)."""

_JUMP = re.compile(
    r"(?:ssh://)?(?:(?P<user>.+)@)?(?:\[(?P<six>[^]]+)]|(?P<host>[^:/]+))(?::(?P<port>\d+))?/?"
)


@dataclass(frozen=True, kw_only=True)
class Destination:
    """Where a connection goes, as which user, and with which keys.

    ``known_as`` is the name that ``known_hosts`` files keep it under: HostKeyAlias where there is one. ``agent`` is the
    socket of the agent to ask (empty: none); of its keys only those of ``identity_files`` with ``only_named``. ``via``
    are the hosts of ProxyJump, in the order they are reached. ``known_hosts`` are the user's and the system's files,
    ``revoked`` those of RevokedHostKeys. ``host_key_algorithms`` are the only ones to accept (empty: all), ``rsa_bits`` the
    least that an RSA key must have.
    """

    host: str
    port: int
    user: str
    known_as: str
    identity_files: tuple[Path, ...] = ()
    only_named: bool = False
    agent: str = ""
    via: tuple[Destination, ...] = ()
    proxy_command: str = ""
    known_hosts: tuple[Path, ...] = ()
    revoked: tuple[Path, ...] = ()
    host_key_algorithms: tuple[str, ...] = ()
    rsa_bits: int = 0

    @property
    def login(self) -> str:
        """The arguments for ``ssh`` or ``ssh-copy-id``: ``pi@pi1``, ``-p 2222 pi@pi1``."""
        return f"{self.user}@{self.host}" if self.port == 22 else f"-p {self.port} {self.user}@{self.host}"


def resolve(robot: Robot, *, config: Path | None = None) -> Destination:
    """Ask OpenSSH how it would reach the robot. The inventory overrides the configuration.

    ``config`` is read in place of the user's and the system's configuration.

    Raises:
        DesktopError: there is no ``ssh`` on this computer.
        Unreachable: OpenSSH refuses its own configuration.

    """
    destination = _ask(_options(robot), robot.address, config=config)
    if robot.identity_file in destination.identity_files or not robot.identity_file:
        return destination
    # OpenSSH leaves out a missing file; keep it, so that the error names it.
    return replace(destination, identity_files=(robot.identity_file, *destination.identity_files))


def login(robot: Robot) -> tuple[str, ...]:
    """The argv of OpenSSH's own client for a robot, which trusts the keys that `fab trust` recorded and asks for no others."""
    files = (robot.known_hosts, *resolve(robot).known_hosts)
    known = " ".join('"' + str(path).replace("%", "%%") + '"' for path in files)
    trusted = ("-o", f"UserKnownHostsFile={known}", "-o", "StrictHostKeyChecking=yes")
    watched = tuple(part for option in _WATCHED for part in ("-o", option))
    return ("ssh", *_options(robot), *trusted, *watched, "--", robot.address)


def parse(text: str, *, address: str) -> Destination:
    """Read what ``ssh -G`` printed for ``address``: lower-case keywords, one a line, some more than once."""
    settings: dict[str, list[str]] = {}
    for line in text.splitlines():
        keyword, _, value = line.partition(" ")
        settings.setdefault(keyword, []).append(value)
    one = {keyword: values[0] for keyword, values in settings.items() if values[0] != "none"}
    host, port, user = one["hostname"], int(one["port"]), one["user"]
    known = settings.get("userknownhostsfile", []) + settings.get("globalknownhostsfile", [])
    agent = one.get("identityagent", "SSH_AUTH_SOCK") if settings.get("identityagent") != ["none"] else ""
    tokens = _tokens(host=host, port=port, user=user, address=address, alias=one.get("hostkeyalias", address))
    files = (Path(_expanded(name, tokens)) for name in settings.get("identityfile", []))
    return Destination(
        host=host,
        port=port,
        user=user,
        known_as=one.get("hostkeyalias") or host_name(host, port),
        identity_files=tuple(file for file in files if file.is_file()),
        only_named=one.get("identitiesonly") == "yes",
        agent=os.environ.get(agent, "") if agent == "SSH_AUTH_SOCK" else _expanded(agent, tokens),
        proxy_command=_replaced(one.get("proxycommand", ""), tokens),
        # Names are printed unquoted and separated by spaces; a name may itself contain spaces.
        known_hosts=tuple(Path(name) for names in known for name in re.split(r" (?=/)", names)),
        revoked=tuple(
            Path(_expanded(name, tokens)) for name in settings.get("revokedhostkeys", []) if name != "none"
        ),
        host_key_algorithms=tuple(filter(None, one.get("hostkeyalgorithms", "").split(","))),
        rsa_bits=int(one.get("requiredrsasize", 0)),
    )


def _ask(options: tuple[str, ...], address: str, *, config: Path | None, hops: int = 0) -> Destination:
    own = ("-F", str(config)) if config else ()
    command = ("ssh", "-T", "-G", *own, *options, "--", address)
    try:
        answer = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=10
        )
    except FileNotFoundError as problem:
        raise DesktopError("OpenSSH's client is missing", cure="install openssh-client") from problem
    except subprocess.TimeoutExpired as problem:
        raise Unreachable(
            "`ssh -G` did not end within 10 s", cure="check the `Match exec` lines in ~/.ssh/config"
        ) from problem
    if answer.returncode:
        reasons = [line for line in answer.stderr.splitlines() if not line.startswith("Warning")] or [
            "no reason given"
        ]
        what = f"OpenSSH rejects its configuration for {address}: {reasons[0].strip()}"
        raise Unreachable(what, cure="fix ~/.ssh/config")
    jumps = re.findall(r"^proxyjump (?!none$)(.+)", answer.stdout, re.MULTILINE)
    destination = parse(answer.stdout, address=address)
    return replace(destination, via=_via(jumps[0], config=config, hops=hops)) if jumps else destination


def _via(jumps: str, *, config: Path | None, hops: int) -> tuple[Destination, ...]:
    """Return the jump hosts in order. Only the first may itself have jump hosts, as with OpenSSH's own client."""
    if hops == _MOST_HOPS:
        raise Unreachable(f"ProxyJump forms a loop at {jumps}", cure="fix ~/.ssh/config")
    route: tuple[Destination, ...] = ()
    for jump in jumps.split(","):
        part = _JUMP.fullmatch(jump)
        if not part:
            raise Unreachable(f"ProxyJump {jump} is not [user@]host[:port]", cure="fix ~/.ssh/config")
        user = ("-l", part["user"]) if part["user"] else ()
        port = ("-p", part["port"]) if part["port"] else ()
        stop = _ask((*user, *port), part["six"] or part["host"], config=config, hops=hops + 1)
        route = (*(route or stop.via), replace(stop, via=()))
    return route


def _options(robot: Robot) -> tuple[str, ...]:
    user = ("-l", robot.user) if robot.user else ()
    port = ("-p", str(robot.port)) if robot.port else ()
    # IdentitiesOnly: a robot with a key of its own is not offered every key of the agent (MaxAuthTries).
    key = ("-i", str(robot.identity_file), "-o", "IdentitiesOnly=yes") if robot.identity_file else ()
    return (*user, *port, *key)


def _tokens(*, host: str, port: int, user: str, address: str, alias: str) -> dict[str, str]:
    """See ssh_config(5), "TOKENS"; those for control sockets are left out."""
    me = pwd.getpwuid(os.getuid())
    here = socket.gethostname()
    short = here.partition(".")[0]
    mine = {"d": me.pw_dir, "i": str(me.pw_uid), "u": me.pw_name, "l": here, "L": short}
    return {"%": "%", "h": host, "k": alias, "n": address, "p": str(port), "r": user, **mine}


def _replaced(text: str, tokens: dict[str, str]) -> str:
    return re.sub("%(.)", lambda match: tokens.get(match[1], match[0]), text)


def _expanded(name: str, tokens: dict[str, str]) -> str:
    """Replace tokens, variables and ``~`` in a file name. ``~`` is the account's home, as in OpenSSH."""
    return _replaced(os.path.expandvars(re.sub("^~(?=/)", "%d", name)), tokens)
