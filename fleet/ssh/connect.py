"""How is an SSH connection to a robot made that never hangs?

The only module that imports Paramiko. A connection has one operation, `Session.run`: run this argv, with or without input.
Fabric's own ``Connection.run`` is not used: it sends about 80 bytes a second through ``in_stream``, and it accepts any host
key.

Every phase of a connection has a time limit. The kernel closes a connection whose bytes stay unacknowledged
(``TCP_USER_TIMEOUT``). While a command runs, a link without a sign of life for `LINK_TIMEOUT` seconds is cut.
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

from fleet.errors import LinkLost, LoginRefused, NotReady, Unreachable, UntrustedHostKey
from fleet.ssh import key_files, known_hosts, openssh_config, revoked_keys, tcp
from fleet.ssh.approach import Approach
from fleet.ssh.channel import AGAIN
from fleet.ssh.known_hosts import HostKey, KnownHosts
from fleet.ssh.proxy_command import ProxySocket
from fleet.ssh.session import ALLOW_FORWARDING, Result, Session, close

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from fleet.config.inventory import Robot
    from fleet.ssh.openssh_config import Destination

    Stream = socket.socket | paramiko.Channel

__all__ = ["ATTEMPTS", "CONNECT_TIMEOUT", "LINK_TIMEOUT", "Result", "Session", "connect", "offered_key"]

CONNECT_TIMEOUT = 10.0
"""Seconds for the TCP connection, again for the banner and the key exchange, and again for each authentication."""

LINK_TIMEOUT = 25.0
"""Seconds without a sign of life after which a link is dead: longer than a Wi-Fi roam, shorter than the time that a lost link is retried."""

LONGEST_PACKET = 256 * 1024
"""Bytes of a packet, as in OpenSSH: a device that only claims to be a robot could send one of 4 GB before it proves anything."""

ATTEMPTS = 6
"""Attempts to connect: in a burst, an sshd drops some connections before its banner (MaxStartups)."""


_TOLD = 300
"""Characters of an error that are told: it may have a whole line of the other end's."""


def connect(
    robot: Robot,
    *,
    connect_timeout: float = CONNECT_TIMEOUT,
    link_timeout: float = LINK_TIMEOUT,
    config: Path | None = None,
    approach: Approach | None = None,
) -> Session:
    """Log in to a robot. ``config`` is read in place of OpenSSH's own configuration; see `CONNECT_TIMEOUT` and `LINK_TIMEOUT`.

    ``approach`` is kept up to date meanwhile.

    Raises:
        Unreachable, UntrustedHostKey, LoginRefused: each with its cause and cure.
        DesktopError: this computer has no OpenSSH client.

    """
    destination = openssh_config.resolve(robot, config=config)
    hops = _Hops(robot.known_hosts, connect_timeout=connect_timeout, link_timeout=link_timeout)
    try:
        for stop in destination.via:
            hops.log_in(stop, jump=True)
        # Behind a command, silence may be that of a jump host with too many connections: it would get more of them.
        hops.log_in(destination, jump=False, approach=None if destination.proxy_command else approach)
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
    """Return the robot's name in ``known_hosts`` files and the host key that it offers now, without logging in.

    Raises:
        As for `connect`; jump hosts must be trusted and let us in.

    """
    destination = openssh_config.resolve(robot, config=config)
    with contextlib.closing(
        _Hops(robot.known_hosts, connect_timeout=connect_timeout, link_timeout=link_timeout)
    ) as hops:
        for stop in destination.via:
            hops.log_in(stop, jump=True)
        return destination.known_as, hops.reach(destination)[0]


class _Transport(paramiko.Transport):
    """Paramiko's transport with AES-GCM first: half the CPU time of its default order, as fast as OpenSSH's client."""

    _preferred_ciphers = (
        "aes128-gcm@openssh.com",
        "aes256-gcm@openssh.com",
        "aes128-ctr",
        "aes192-ctr",
        "aes256-ctr",
    )

    def __init__(
        self, stream: Stream, *, prefer: tuple[str, ...], only: tuple[str, ...], connect_timeout: float
    ) -> None:
        super().__init__(stream)
        # `start_client` has its own limit. That must pass first: it tells an sshd that is silent from one that hangs up.
        self.banner_timeout = self.auth_timeout = 2 * connect_timeout
        usual: tuple[str, ...] = paramiko.Transport._preferred_keys  # type: ignore[attr-defined]  # noqa: SLF001
        self._read_all = self.packetizer.read_all
        self.packetizer.read_all = self._read_some  # type: ignore[method-assign,assignment]
        allowed = [name for name in usual if name in only or not only]
        self._preferred_keys = tuple(dict.fromkeys((*(name for name in prefer if name in allowed), *allowed)))

    def _read_some(self, count: int, check_rekey: bool = False) -> bytes:
        if count > LONGEST_PACKET:
            raise paramiko.SSHException(f"it announced a packet of {count} bytes")
        return self._read_all(count, check_rekey)

    def _log(self, level: int, msg: object, *args: object) -> None:
        """Log nothing: errors are raised, and Paramiko would print tracebacks of a robot's protocol errors."""

    def begin(self, command: str) -> paramiko.Channel:
        try:
            channel = self.open_session()
            channel.exec_command(command)
        except (paramiko.SSHException, EOFError, OSError) as problem:
            self.join(0.5)  # the sender may notice a lost link before the reading thread
            if self.is_active():
                cure = "the robot may be out of memory or processes: try again, or restart it"
                raise NotReady(f"the robot's sshd cannot start a command: {problem}", cure=cure) from problem
            raise LinkLost("the connection was lost before the command started", cure=AGAIN) from problem
        return channel

    def listen(self, take: Callable[[paramiko.Channel], None]) -> int:
        try:
            return self.request_port_forward("127.0.0.1", 0, lambda channel, _from, _to: take(channel))
        except (paramiko.SSHException, EOFError, OSError) as problem:
            if self.is_active():
                raise NotReady("its sshd forwards no ports", cure=ALLOW_FORWARDING) from problem
            raise LinkLost(
                "the connection was lost before its sshd forwarded a port", cure=AGAIN
            ) from problem

    def close(self) -> None:
        super().close()
        self.packetizer.complete_handshake()  # otherwise its timer delays the end of Python for up to 15 s


class _Agent(AgentSSH):
    """An ssh-agent at any socket: Paramiko's own class knows only SSH_AUTH_SOCK. Without an agent it has no keys."""

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
    """The connections to the jump hosts and the robot, each made through the one before; the last is the robot's."""

    def __init__(self, recorded: Path, *, connect_timeout: float, link_timeout: float) -> None:
        self.chain: list[_Transport] = []
        self._recorded = recorded
        self._connect_timeout = connect_timeout
        self._link_timeout = link_timeout

    def close(self) -> None:
        """Close all connections."""
        close(self.chain)

    def reach(self, stop: Destination, approach: Approach | None = None) -> tuple[HostKey, KnownHosts]:
        """Connect to an sshd. Returns the host key that it proved to own and nobody has revoked, and the recorded keys."""
        known = known_hosts.read((self._recorded, *stop.known_hosts))
        approach = approach or Approach()
        for attempt in range(1, ATTEMPTS + 1):
            approach.ask()
            stream = self._stream(stop)
            transport = _Transport(
                stream,
                prefer=known.algorithms(stop.known_as),
                only=stop.host_key_algorithms,
                connect_timeout=self._connect_timeout,
            )
            self.chain.append(transport)
            approach.listen(transport)
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
                approach.end()
                pause = self._connect_timeout * attempt / 10
                time.sleep(random.uniform(pause / 5, pause))  # noqa: S311  a burst must not come back as one
            else:
                approach.end()
                return _acceptable(key, stop), known
        raise AssertionError("the last attempt returns or raises")

    def log_in(self, stop: Destination, *, jump: bool, approach: Approach | None = None) -> None:
        """Connect to an sshd, check its host key, and log in with the first key that it accepts."""
        key, known = self.reach(stop, approach)
        known_hosts.check(key, name=stop.known_as, known=known, jump=jump)
        refusals: list[str] = []
        with contextlib.closing(_Agent(stop.agent)) as agent:
            for label, load in _keys(stop, agent):
                if not (refusal := self._refusal(stop, label, load)):
                    return
                refusals.append(refusal)
        too_open = [path for path in stop.identity_files if key_files.too_open(path)]
        cure = f"chmod 600 {too_open[0]}" if too_open else f"ssh-copy-id {stop.login}"
        if not refusals:
            self._ask_what_it_takes(stop)
            refusals, cure = (
                ["there is no key in ~/.ssh and none in the ssh-agent"],
                f"ssh-keygen, then {cure}",
            )
        raise LoginRefused(f"{stop.host} does not let {stop.user} in: {', '.join(refusals)}", cure=cure)

    def _refusal(self, stop: Destination, label: str, load: Callable[[], paramiko.PKey]) -> str:
        """Try a key. Returns why it was not accepted, or nothing if it was."""
        transport, answered = self.chain[-1], threading.Event()
        try:
            transport.auth_publickey(stop.user, load(), answered)
        except TypeError:  # the cryptography library raises this for a missing passphrase
            return f"{label} has a passphrase (`ssh-add {label}` unlocks it)"
        except Exception as problem:  # a key file may hold anything
            if not transport.is_active():
                raise _lost(stop) from problem
            return f"{label} cannot be used ({str(problem).partition('. ')[0]})"
        if not answered.wait(self._connect_timeout):
            raise Unreachable(f"{stop.host} stopped answering during the login", cure=AGAIN)
        if transport.is_authenticated():
            return ""
        raised = transport.get_exception()
        if isinstance(raised, paramiko.BadAuthenticationType):
            raise _takes_no_keys(stop, raised) from raised
        if isinstance(raised, PartialAuthentication):
            more = " and ".join(raised.allowed_types)
            raise LoginRefused(
                f"{stop.host} accepts {label} but also requires {more}",
                cure="allow login with a key alone (AuthenticationMethods in its sshd_config)",
            )
        if isinstance(raised, EOFError | OSError):
            raise _lost(stop) from raised
        if not transport.is_active():
            why = f" ({raised})" if raised else ""
            what = f"{stop.host} ended the login of {stop.user} at {label}{why}"
            raise LoginRefused(
                what, cure="if many keys were offered before, set identity_file in the inventory"
            )
        return f"{label} is refused"

    def _ask_what_it_takes(self, stop: Destination) -> None:
        try:
            self.chain[-1].auth_none(stop.user)
        except paramiko.BadAuthenticationType as problem:
            if "publickey" not in problem.allowed_types:
                raise _takes_no_keys(stop, problem) from problem
        except (paramiko.SSHException, EOFError, OSError) as problem:
            raise Unreachable(f"{stop.host} stopped answering during the login", cure=AGAIN) from problem

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
            raise Unreachable(
                what,
                cure="check that the robot is on, and that the jump host allows forwarding (AllowTcpForwarding)",
            ) from problem


def _keys(stop: Destination, agent: _Agent) -> Iterator[tuple[str, Callable[[], paramiko.PKey]]]:
    """Yield the keys to try, in OpenSSH's order: the agent's keys, configured ones first; then the other key files."""
    files = {key_files.public_half(path) or str(path).encode(): path for path in stop.identity_files}
    held = {key.asbytes(): key for key in agent.get_keys()}
    for blob in sorted(held, key=lambda blob: blob not in files):
        if blob in files or not stop.only_named:
            yield f"the agent's key {files.get(blob) or held[blob].comment}", partial(_same, held[blob])
    for blob, path in files.items():
        if blob not in held:
            yield str(path), partial(_private, path, stop.rsa_bits)


def _acceptable(key: paramiko.PKey, stop: Destination) -> HostKey:
    """Return a host key that OpenSSH's configuration does not refuse, whoever trusts it."""
    if _is_short(key, stop.rsa_bits):
        what = f"the host key of {stop.known_as} has {key.get_bits()} bits, and RequiredRSASize is {stop.rsa_bits}"
        raise UntrustedHostKey(what, cure="make new host keys on it with `ssh-keygen -A`")
    offered = HostKey(kind=key.get_name(), blob=key.asbytes())
    revoked_keys.refuse(offered, stop.revoked, name=stop.known_as)
    return offered


def _is_short(key: paramiko.PKey, least: int) -> bool:
    return key.get_name() == "ssh-rsa" and key.get_bits() < least


def _private(path: Path, rsa_bits: int) -> paramiko.PKey:
    if mode := key_files.too_open(path):
        raise PermissionError(f"its mode {mode:04o} lets others read it")
    key: paramiko.PKey = paramiko.PKey.from_path(path)
    if _is_short(key, rsa_bits):
        raise ValueError(f"it has {key.get_bits()} bits, and RequiredRSASize is {rsa_bits}")
    return key


def _same(key: paramiko.PKey) -> paramiko.PKey:
    return key


def _was_dropped(stream: Stream, problem: BaseException) -> bool:
    """Whether the other end closed the connection before the SSH banner, and a ProxyCommand printed no reason."""
    return isinstance(problem.__context__, EOFError | OSError) and not getattr(stream, "last_error", "")


def _lost(
    stop: Destination,
) -> Unreachable:  # an sshd that refuses a login says so before it closes the connection
    return Unreachable(f"the connection to {stop.host} was lost during the login", cure=AGAIN)


def _takes_no_keys(stop: Destination, problem: paramiko.BadAuthenticationType) -> LoginRefused:
    what = f"{stop.host} accepts only {' or '.join(problem.allowed_types)} for {stop.user}, and fleet logs in with keys"
    return LoginRefused(
        what, cure=f"allow keys (PubkeyAuthentication) in its sshd_config, then run ssh-copy-id {stop.login}"
    )


def _unreachable(
    stop: Destination, stream: Stream, transport: _Transport, problem: BaseException, *, silent: bool
) -> Unreachable:
    where = f"{stop.host}:{stop.port}"
    if isinstance(stream, ProxySocket) and stream.last_error:
        return Unreachable(
            f"the ProxyCommand to {where} failed: {stream.last_error}", cure="try to reach it with `ssh`"
        )
    if transport.remote_version:
        what = (
            "stopped answering during the key exchange"
            if silent
            else f"broke off the key exchange: {str(problem)[:_TOLD] or 'it closed the connection'}"
        )
        return Unreachable(f"{where} {what}", cure="the robot may be overloaded, or its OpenSSH very old")
    if silent:
        return Unreachable(
            f"{where} accepts the connection but sends no SSH banner",
            cure="the robot may be overloaded or frozen: restart it",
        )
    cure = "check the port; a busy sshd (MaxStartups), or one that blocks this address, does the same"
    return Unreachable(
        f"{where} closed the connection, or is not an SSH server: {str(problem)[:_TOLD]}", cure=cure
    )
