"""How does a command, or a stream of bytes, reach a robot and never hang?

The only module that imports Paramiko. It knows one verb, `Session.run`: run this argv, maybe feeding it bytes. Fabric's
own ``Connection.run`` is not used: it moves about 80 bytes a second through ``in_stream`` and accepts any host key.

Nothing here waits for ever. Every phase of a connection has a time limit, the kernel gives up on unacknowledged bytes
(``TCP_USER_TIMEOUT``), and while a command runs a link that shows no sign of life for `LINK_TIMEOUT` seconds is cut.
"""

from __future__ import annotations

import contextlib
import random
import socket
import threading
import time
from functools import partial
from typing import TYPE_CHECKING

import paramiko
from paramiko.agent import AgentSSH
from paramiko.ssh_exception import PartialAuthentication

from fleet.errors import LinkLost, LoginRefused, NotReady, Unreachable
from fleet.ssh import key_files, known_hosts, openssh_config, tcp
from fleet.ssh.channel import AGAIN
from fleet.ssh.known_hosts import HostKey, KnownHosts
from fleet.ssh.proxy_command import ProxySocket
from fleet.ssh.session import Result, Session, close

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.ssh.openssh_config import Destination

    Stream = socket.socket | paramiko.Channel

__all__ = ["ATTEMPTS", "CONNECT_TIMEOUT", "LINK_TIMEOUT", "Result", "Session", "connect", "offered_key"]

CONNECT_TIMEOUT = 10.0
"""Seconds for a TCP connection, and again for the banner with the key exchange, and for each authentication."""

LINK_TIMEOUT = 25.0
"""Seconds without a sign of life after which a link is dead: longer than a Wi-Fi roam, shorter than the time that a lost link is retried."""

ATTEMPTS = 6
"""A burst of connections makes an sshd drop some before its banner (MaxStartups); those are tried again."""


def connect(
    robot: Robot,
    *,
    connect_timeout: float = CONNECT_TIMEOUT,
    link_timeout: float = LINK_TIMEOUT,
    config: Path | None = None,
) -> Session:
    """Log in to a robot. ``config`` is read in place of OpenSSH's own configuration; see `CONNECT_TIMEOUT` and `LINK_TIMEOUT`.

    Raises:
        Unreachable, UntrustedHostKey, LoginRefused: each with its cause and cure.
        DesktopError: this computer has no OpenSSH client.

    """
    destination = openssh_config.resolve(robot, config=config)
    hops = _Hops(robot.known_hosts, connect_timeout=connect_timeout, link_timeout=link_timeout)
    try:
        for stop in (*destination.via, destination):
            hops.log_in(stop, jump=stop is not destination)
    except BaseException:
        hops.close()
        raise
    return Session(chain=tuple(hops.chain), link_timeout=link_timeout)


def offered_key(
    robot: Robot,
    *,
    connect_timeout: float = CONNECT_TIMEOUT,
    link_timeout: float = LINK_TIMEOUT,
    config: Path | None = None,
) -> tuple[str, HostKey]:
    """The name ``known_hosts`` files keep this robot under, and the key it offers now; nobody logs in to it.

    Raises:
        As for `connect`; the hosts on the way must be trusted and let us in.

    """
    destination = openssh_config.resolve(robot, config=config)
    with contextlib.closing(
        _Hops(robot.known_hosts, connect_timeout=connect_timeout, link_timeout=link_timeout)
    ) as hops:
        for stop in destination.via:
            hops.log_in(stop, jump=True)
        return destination.known_as, hops.reach(destination)[0]


class _Transport(paramiko.Transport):
    """Paramiko's, with AES-GCM first: half the CPU of its default order, and as fast as OpenSSH's own client."""

    _preferred_ciphers = (
        "aes128-gcm@openssh.com",
        "aes256-gcm@openssh.com",
        "aes128-ctr",
        "aes192-ctr",
        "aes256-ctr",
    )

    def __init__(self, stream: Stream, *, prefer: tuple[str, ...], connect_timeout: float) -> None:
        super().__init__(stream)
        # `start_client` has its own limit. That must pass first: it tells an sshd that is silent from one that hangs up.
        self.banner_timeout = self.auth_timeout = 2 * connect_timeout
        usual: tuple[str, ...] = paramiko.Transport._preferred_keys  # type: ignore[attr-defined]  # noqa: SLF001
        self._preferred_keys = tuple(dict.fromkeys((*(name for name in prefer if name in usual), *usual)))

    def _log(self, level: int, msg: object, *args: object) -> None:
        """Nothing: what matters is raised, and Paramiko prints tracebacks of what a robot does wrong."""

    def begin(self, command: str) -> paramiko.Channel:
        try:
            channel = self.open_session()
            channel.exec_command(command)
        except (paramiko.SSHException, EOFError, OSError) as problem:
            self.join(0.5)  # who sends may notice a lost link before the thread that listens
            if self.is_active():
                cure = "is it out of memory or processes? try again, or restart it"
                raise NotReady(f"the robot's sshd starts no command: {problem}", cure=cure) from problem
            raise LinkLost("the connection was lost before the command started", cure=AGAIN) from problem
        return channel

    def close(self) -> None:
        super().close()
        self.packetizer.complete_handshake()  # else its timer keeps Python from ending for up to 15 s


class _Agent(AgentSSH):
    """An ssh-agent at a socket of our choice: Paramiko's own knows SSH_AUTH_SOCK only. No agent, no keys."""

    def __init__(self, path: str) -> None:
        super().__init__()
        sock = socket.socket(socket.AF_UNIX)
        sock.settimeout(CONNECT_TIMEOUT)
        try:
            sock.connect(path)
            self._connect(sock)  # type: ignore[attr-defined]
        except (OSError, paramiko.SSHException):
            sock.close()

    def close(self) -> None:
        self._close()  # type: ignore[attr-defined]


class _Hops:
    """The connections to a robot, each made through the one before; the last is the robot's."""

    def __init__(self, recorded: Path, *, connect_timeout: float, link_timeout: float) -> None:
        self.chain: list[_Transport] = []
        self._recorded = recorded
        self._connect_timeout = connect_timeout
        self._link_timeout = link_timeout

    def close(self) -> None:
        """End them all."""
        close(self.chain)

    def reach(self, stop: Destination) -> tuple[HostKey, KnownHosts]:
        """Connect to an sshd. The host key it proved to own, and what is on record."""
        known = known_hosts.read((self._recorded, *stop.known_hosts))
        for attempt in range(1, ATTEMPTS + 1):
            stream = self._stream(stop)
            transport = _Transport(
                stream, prefer=known.algorithms(stop.known_as), connect_timeout=self._connect_timeout
            )
            self.chain.append(transport)
            try:
                transport.start_client(timeout=self._connect_timeout)
                key = transport.get_remote_server_key()
            except (paramiko.SSHException, EOFError, OSError) as problem:
                silent = transport.is_active()
                self.chain.pop().close()
                transport.join(1)
                stream.close()
                if silent or attempt == ATTEMPTS or not _was_dropped(stream, problem):
                    raise _unreachable(stop, stream, transport, problem, silent=silent) from problem
                pause = self._connect_timeout * attempt / 10
                time.sleep(random.uniform(pause / 5, pause))  # noqa: S311  a burst must not come back as one
            else:
                return HostKey(kind=key.get_name(), blob=key.asbytes()), known
        raise AssertionError("the last attempt returns or raises")

    def log_in(self, stop: Destination, *, jump: bool) -> None:
        """Connect to an sshd, check its host key, prove who we are."""
        key, known = self.reach(stop)
        known_hosts.check(key, name=stop.known_as, known=known, jump=jump)
        refusals: list[str] = []
        with contextlib.closing(_Agent(stop.agent)) as agent:
            for label, load in _keys(stop, agent):
                if not (refusal := self._refusal(stop, label, load)):
                    return
                refusals.append(refusal)
        cure = f"ssh-copy-id {stop.login}"
        if not refusals:
            self._ask_what_it_takes(stop)
            refusals, cure = ["there is no key in ~/.ssh and none in the agent"], f"ssh-keygen, then {cure}"
        raise LoginRefused(f"{stop.host} does not let {stop.user} in: {', '.join(refusals)}", cure=cure)

    def _refusal(self, stop: Destination, label: str, load: Callable[[], paramiko.PKey]) -> str:
        """Why this key does not let us in; empty if it did."""
        transport, answered = self.chain[-1], threading.Event()
        try:
            transport.auth_publickey(stop.user, load(), answered)
        except TypeError:  # how the cryptography library says that it wants a passphrase
            return f"{label} has a passphrase (`ssh-add {label}` unlocks it)"
        except Exception as problem:  # a key file may hold anything
            if not transport.is_active():
                raise _lost(stop) from problem
            return f"{label} cannot be used ({str(problem).partition('. ')[0]})"
        if not answered.wait(self._connect_timeout):
            raise Unreachable(f"{stop.host} stops answering during the login", cure=AGAIN)
        if transport.is_authenticated():
            return ""
        raised = transport.get_exception()
        if isinstance(raised, paramiko.BadAuthenticationType):
            raise _takes_no_keys(stop, raised) from raised
        if isinstance(raised, PartialAuthentication):
            more = " and ".join(raised.allowed_types)
            raise LoginRefused(
                f"{stop.host} takes {label}, and wants {more} as well", cure="let a key be enough"
            )
        if isinstance(raised, EOFError | OSError):
            raise _lost(stop) from raised
        if not transport.is_active():
            why = f" ({raised})" if raised else ""
            what = f"{stop.host} ends the login of {stop.user} at {label}{why}"
            raise LoginRefused(what, cure="if many keys were offered before, set identity_file")
        return f"{label} is refused"

    def _ask_what_it_takes(self, stop: Destination) -> None:
        try:
            self.chain[-1].auth_none(stop.user)
        except paramiko.BadAuthenticationType as problem:
            if "publickey" not in problem.allowed_types:
                raise _takes_no_keys(stop, problem) from problem
        except (paramiko.SSHException, EOFError, OSError) as problem:
            raise Unreachable(f"{stop.host} stops answering during the login", cure=AGAIN) from problem

    def _stream(self, stop: Destination) -> Stream:
        if not self.chain:
            if stop.proxy_command:
                return ProxySocket(stop.proxy_command)
            return tcp.connect(
                stop.host, stop.port, connect_timeout=self._connect_timeout, link_timeout=self._link_timeout
            )
        target, here = (stop.host, stop.port), ("127.0.0.1", 0)
        try:
            return self.chain[-1].open_channel("direct-tcpip", target, here, timeout=self._connect_timeout)
        except (paramiko.SSHException, EOFError, OSError) as problem:
            reason = getattr(problem, "text", "") or problem
            what = f"{stop.host}:{stop.port} cannot be reached from the jump host: {reason}"
            raise Unreachable(what, cure="is it on, and does the jump host allow forwarding?") from problem


def _keys(stop: Destination, agent: _Agent) -> Iterator[tuple[str, Callable[[], paramiko.PKey]]]:
    """The keys to try, in OpenSSH's order: the agent's, those that are named first; then the files it does not hold."""
    files = {key_files.public_half(path) or str(path).encode(): path for path in stop.identity_files}
    held = {key.asbytes(): key for key in agent.get_keys()}
    for blob in sorted(held, key=lambda blob: blob not in files):
        if blob in files or not stop.only_named:
            yield f"the agent's key {files.get(blob) or held[blob].comment}", partial(_same, held[blob])
    for blob, path in files.items():
        if blob not in held:
            yield str(path), partial(paramiko.PKey.from_path, path)


def _same(key: paramiko.PKey) -> paramiko.PKey:
    return key


def _was_dropped(stream: Stream, problem: BaseException) -> bool:
    """Whether the other end hung up before it spoke SSH, and a ProxyCommand gave no reason of its own."""
    return isinstance(problem.__context__, EOFError | OSError) and not getattr(stream, "said", "")


def _lost(stop: Destination) -> Unreachable:  # an sshd that refuses says so before it hangs up
    return Unreachable(f"the connection to {stop.host} was lost during the login", cure=AGAIN)


def _takes_no_keys(stop: Destination, problem: paramiko.BadAuthenticationType) -> LoginRefused:
    what = f"{stop.host} lets {stop.user} in by {' or '.join(problem.allowed_types)} only, and fleet logs in with keys"
    return LoginRefused(
        what, cure=f"allow keys (PubkeyAuthentication) in its sshd_config, then ssh-copy-id {stop.login}"
    )


def _unreachable(
    stop: Destination, stream: Stream, transport: _Transport, problem: BaseException, *, silent: bool
) -> Unreachable:
    where = f"{stop.host}:{stop.port}"
    if isinstance(stream, ProxySocket) and stream.said:
        return Unreachable(f"the ProxyCommand to {where} fails: {stream.said}", cure="try `ssh` to it")
    if transport.remote_version:
        what = (
            "stops answering in the key exchange"
            if silent
            else f"breaks off the key exchange: {problem or 'it hangs up'}"
        )
        return Unreachable(f"{where} {what}", cure="is the robot overloaded, or its OpenSSH very old?")
    if silent:
        return Unreachable(
            f"{where} accepts the connection and says nothing", cure="is the robot overloaded or frozen?"
        )
    cure = "is that sshd's port? a busy sshd (MaxStartups) and one that blocks this address hang up like this too"
    return Unreachable(f"{where} hangs up, or is not an SSH server: {problem}", cure=cure)
