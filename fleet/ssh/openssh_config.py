"""How does OpenSSH's configuration say a robot is reached? One question to ``ssh -G``, which knows every keyword.

Fabric and Paramiko read a part of ``ssh_config(5)`` only (no Include, HostKeyAlias, IdentitiesOnly); ``ssh -G`` prints
what OpenSSH itself would use, but for the tokens of some values (``%h``), which are put in here.
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

_LONGEST_WAY = 8
_JUMP = re.compile(
    r"(?:ssh://)?(?:(?P<user>.+)@)?(?:\[(?P<six>[^]]+)]|(?P<host>[^:/]+))(?::(?P<port>\d+))?/?"
)


@dataclass(frozen=True, kw_only=True)
class Destination:
    """Where a connection goes, as whom, and how it proves itself.

    ``known_as`` is the name that ``known_hosts`` files keep it under: HostKeyAlias where there is one. ``agent`` is the
    socket of the agent to ask (empty: none); of its keys only those of ``identity_files`` with ``only_named``. ``via``
    are the hosts of ProxyJump, in the order they are reached. ``known_hosts`` are the user's and the system's files.
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

    @property
    def login(self) -> str:
        """As a person writes it behind ``ssh`` or ``ssh-copy-id``: ``pi@pi1``, ``-p 2222 pi@pi1``."""
        return f"{self.user}@{self.host}" if self.port == 22 else f"-p {self.port} {self.user}@{self.host}"


def resolve(robot: Robot, *, config: Path | None = None) -> Destination:
    """Ask OpenSSH how it would reach the robot; what the inventory says comes before what the configuration says.

    ``config`` is read in place of the user's and the system's configuration.

    Raises:
        DesktopError: there is no ``ssh`` on this computer.
        Unreachable: OpenSSH refuses its own configuration.

    """
    found = _ask(_options(robot), robot.address, config=config)
    if robot.identity_file in found.identity_files or not robot.identity_file:
        return found
    # It is not there, and what is tried instead must not hide that.
    return replace(found, identity_files=(robot.identity_file, *found.identity_files))


def login(robot: Robot) -> tuple[str, ...]:
    """The argv of OpenSSH's own client for a robot, with the keys that `fab trust` recorded and no others asked for."""
    files = (robot.known_hosts, *resolve(robot).known_hosts)
    known = " ".join('"' + str(path).replace("%", "%%") + '"' for path in files)
    trusted = ("-o", f"UserKnownHostsFile={known}", "-o", "StrictHostKeyChecking=yes")
    return ("ssh", *_options(robot), *trusted, "--", robot.address)


def parse(text: str, *, address: str) -> Destination:
    """Read what ``ssh -G`` printed for ``address``: lower-case keywords, one a line, some more than once."""
    said: dict[str, list[str]] = {}
    for line in text.splitlines():
        keyword, _, value = line.partition(" ")
        said.setdefault(keyword, []).append(value)
    one = {keyword: values[0] for keyword, values in said.items() if values[0] != "none"}
    host, port, user = one["hostname"], int(one["port"]), one["user"]
    known = said.get("userknownhostsfile", []) + said.get("globalknownhostsfile", [])
    agent = one.get("identityagent", "SSH_AUTH_SOCK") if said.get("identityagent") != ["none"] else ""
    tokens = _tokens(host=host, port=port, user=user, address=address, alias=one.get("hostkeyalias", address))
    files = (Path(_expanded(name, tokens)) for name in said.get("identityfile", []))
    return Destination(
        host=host,
        port=port,
        user=user,
        known_as=one.get("hostkeyalias") or host_name(host, port),
        identity_files=tuple(file for file in files if file.is_file()),
        only_named=one.get("identitiesonly") == "yes",
        agent=os.environ.get(agent, "") if agent == "SSH_AUTH_SOCK" else _expanded(agent, tokens),
        proxy_command=_put_in(one.get("proxycommand", ""), tokens),
        # Names are printed unquoted, with spaces between them: a name that has spaces of its own is still one.
        known_hosts=tuple(Path(name) for names in known for name in re.split(r" (?=/)", names)),
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
        raise Unreachable("`ssh -G` hangs", cure="look for a Match exec in ~/.ssh/config") from problem
    if answer.returncode:
        said = [line for line in answer.stderr.splitlines() if not line.startswith("Warning")] or [
            "no reason given"
        ]
        what = f"OpenSSH refuses its configuration for {address}: {said[0].strip()}"
        raise Unreachable(what, cure="mend ~/.ssh/config")
    jumps = re.findall(r"^proxyjump (?!none$)(.+)", answer.stdout, re.MULTILINE)
    destination = parse(answer.stdout, address=address)
    return replace(destination, via=_via(jumps[0], config=config, hops=hops)) if jumps else destination


def _via(jumps: str, *, config: Path | None, hops: int) -> tuple[Destination, ...]:
    """The hosts on the way. Only the first may itself be reached through others, as with OpenSSH's own client."""
    if hops == _LONGEST_WAY:
        raise Unreachable(f"ProxyJump goes round in circles at {jumps}", cure="mend ~/.ssh/config")
    way: tuple[Destination, ...] = ()
    for jump in jumps.split(","):
        part = _JUMP.fullmatch(jump)
        if not part:
            raise Unreachable(f"ProxyJump {jump} is not [user@]host[:port]", cure="mend ~/.ssh/config")
        user = ("-l", part["user"]) if part["user"] else ()
        port = ("-p", part["port"]) if part["port"] else ()
        stop = _ask((*user, *port), part["six"] or part["host"], config=config, hops=hops + 1)
        way = (*(way or stop.via), replace(stop, via=()))
    return way


def _options(robot: Robot) -> tuple[str, ...]:
    user = ("-l", robot.user) if robot.user else ()
    port = ("-p", str(robot.port)) if robot.port else ()
    # IdentitiesOnly: a robot that is given a key is not offered every key of the agent (MaxAuthTries).
    key = ("-i", str(robot.identity_file), "-o", "IdentitiesOnly=yes") if robot.identity_file else ()
    return (*user, *port, *key)


def _tokens(*, host: str, port: int, user: str, address: str, alias: str) -> dict[str, str]:
    """See ssh_config(5), "TOKENS"; those for control sockets are left out."""
    me = pwd.getpwuid(os.getuid())
    here = socket.gethostname()
    short = here.partition(".")[0]
    mine = {"d": me.pw_dir, "i": str(me.pw_uid), "u": me.pw_name, "l": here, "L": short}
    return {"%": "%", "h": host, "k": alias, "n": address, "p": str(port), "r": user, **mine}


def _put_in(text: str, tokens: dict[str, str]) -> str:
    return re.sub("%(.)", lambda found: tokens.get(found[1], found[0]), text)


def _expanded(name: str, tokens: dict[str, str]) -> str:
    """A file name with its tokens, variables and ``~`` replaced. The home is the account's, as OpenSSH has it."""
    return _put_in(os.path.expandvars(re.sub("^~(?=/)", "%d", name)), tokens)
