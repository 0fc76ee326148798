"""How does a command, or a stream of bytes, reach a robot and never hang?

The only module that imports Paramiko. It knows one verb, `Session.run`: run this argv, maybe feeding it bytes. Fabric's
own ``Connection.run`` is not used: it moves about 80 bytes a second through ``in_stream`` and accepts any host key.

Nothing here waits for ever. Every phase of a connection has a time limit, the kernel gives up on unacknowledged bytes
(``TCP_USER_TIMEOUT``), and while a command runs a link that shows no sign of life for `SILENCE` seconds is cut.
"""

from __future__ import annotations

import base64
import contextlib
import random
import shlex
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Self

import paramiko

from fleet import hostkeys, sshconfig, tcp
from fleet.errors import LinkLost, LoginRefused, TimedOut, Unreachable
from fleet.exchange import Exchange
from fleet.hostkeys import HostKey, KnownHosts

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path
    from types import TracebackType

    from fleet.exchange import Hearer, Teller
    from fleet.inventory import Robot
    from fleet.sshconfig import Destination

    Stream = socket.socket | paramiko.Channel | paramiko.ProxyCommand

CONNECT = 10.0
"""Seconds for a TCP connection, and again for the banner, the key exchange and each authentication."""

SILENCE = 25.0
"""Seconds without a sign of life after which a link is dead: longer than a Wi-Fi roam, shorter than patience."""

ATTEMPTS = 3
"""A burst of connections makes an sshd drop some before the banner (MaxStartups); those are tried again."""


class _Transport(paramiko.Transport):
    """Paramiko's, with AES-GCM first: half the CPU of its default order, and as fast as OpenSSH's own client."""

    _preferred_ciphers = (
        "aes128-gcm@openssh.com",
        "aes256-gcm@openssh.com",
        "aes128-ctr",
        "aes192-ctr",
        "aes256-ctr",
    )


@dataclass(frozen=True, kw_only=True)
class Result:
    """How a command ended: its exit code, and what it wrote (as text; undecodable bytes replaced)."""

    code: int
    output: str
    errors: str


class Session:
    """One robot's connection. Make it with `connect`; use it from one thread at a time; `close` from any."""

    def __init__(self, *, robot: Robot, chain: tuple[paramiko.Transport, ...]) -> None:
        self.robot = robot
        self._chain = chain

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the connection; a command that runs on it ends with `LinkLost`."""
        _close(self._chain)

    def run(
        self,
        argv: tuple[str, ...],
        *,
        feed: Iterable[bytes] | None = (),
        limit: float | None = 60.0,
        sent: Teller | None = None,
        heard: Hearer | None = None,
    ) -> Result:
        """Run a command and wait for its end.

        ``feed`` becomes its standard input; ``None`` leaves that open and empty until the connection closes. ``limit``
        is in seconds, and kept on the robot by ``timeout``, so that nothing runs on there. ``sent`` is told the bytes
        of each piece that left; ``heard`` is given standard output as it comes, which then is not kept.

        Raises:
            LinkLost: the connection ended or fell silent.
            TimedOut: ``limit`` passed.

        """
        bounded = argv if limit is None else ("timeout", "--kill-after=5", f"{limit:g}", *argv)
        transport = self._chain[-1]
        try:
            channel = transport.open_session(timeout=CONNECT)
            channel.exec_command(shlex.join(bounded))
        except (paramiko.SSHException, EOFError, OSError) as problem:
            raise LinkLost("the connection was lost before the command started", cure=_AGAIN) from problem
        with contextlib.closing(channel):
            exchange = Exchange(channel=channel, transport=transport, silence=SILENCE)
            code = exchange.run(feed=feed, limit=limit, sent=sent, heard=heard)
        if code in (124, 137) and limit is not None:
            raise TimedOut(f"`{argv[0]}` took longer than {limit:g} s and was ended on the robot")
        return Result(code=code, output=exchange.output, errors=exchange.errors)


def connect(robot: Robot) -> Session:
    """Log in to a robot.

    Raises:
        Unreachable, UntrustedHostKey, LoginRefused: each with its cause and cure.
        DesktopError: this computer has no OpenSSH client.

    """
    destination = sshconfig.resolve(robot)
    known = hostkeys.read((robot.known_hosts, *destination.known_hosts))
    for attempt in range(1, ATTEMPTS + 1):
        chain: list[paramiko.Transport] = []
        try:
            _log_in(destination, known=known, chain=chain)
        except Unreachable as problem:
            _close(chain)
            if attempt == ATTEMPTS or not isinstance(problem.__cause__, _DROPPED):
                raise
            time.sleep(random.uniform(0.3, 1.0) * attempt)  # noqa: S311  jitter: a burst must not come back as one
        except BaseException:
            _close(chain)
            raise
        else:
            return Session(robot=robot, chain=tuple(chain))
    raise AssertionError("the last attempt returns or raises")


def offered_key(robot: Robot) -> tuple[str, hostkeys.HostKey]:
    """The name ``known_hosts`` files keep this robot under, and the key it offers now; nobody logs in.

    Raises:
        Unreachable, DesktopError: as for `connect`.

    """
    destination = sshconfig.resolve(robot)
    known = hostkeys.read((robot.known_hosts, *destination.known_hosts))
    chain: list[paramiko.Transport] = []
    try:
        return destination.known_as, _exchange_keys(destination, known=known, chain=chain)
    finally:
        _close(chain)


_AGAIN = "see that the robot has power and signal, then run the same command again"
_DROPPED = (paramiko.SSHException, EOFError, ConnectionResetError, BrokenPipeError)


def _close(chain: Iterable[paramiko.Transport]) -> None:
    for transport in reversed(tuple(chain)):
        transport.close()


def _log_in(destination: Destination, *, known: KnownHosts, chain: list[paramiko.Transport]) -> None:
    """Exchange keys, check the robot's, prove who we are. Adds what it opens to ``chain``, jump hosts first."""
    key = _exchange_keys(destination, known=known, chain=chain)
    hostkeys.check(key, name=destination.known_as, known=known)
    transport, who = chain[-1], f"{destination.user}@{destination.host}"
    refusals: list[str] = []
    for path, load in _keys(destination):
        try:
            transport.auth_publickey(destination.user, load())
        except paramiko.BadAuthenticationType as problem:
            offered = " or ".join(problem.allowed_types)
            cure = f"allow keys in the robot's sshd_config, then ssh-copy-id -p {destination.port} {who}"
            raise LoginRefused(f"{who} takes {offered} only; fleet logs in with keys", cure=cure) from problem
        except paramiko.PasswordRequiredException:
            refusals.append(f"{path} is encrypted (`ssh-add {path}` unlocks it)")
        except paramiko.AuthenticationException:
            refusals.append(f"{path} was refused")
        except (paramiko.SSHException, EOFError, OSError, ValueError) as problem:
            if not transport.is_active():
                raise LoginRefused(
                    f"{who} ended the login", cure="it may have been offered too many keys: set identity_file"
                ) from problem
            refusals.append(f"{path} cannot be used ({problem})")
        else:
            return
    tried = "; ".join(refusals) or "there is no key in ~/.ssh and none in the agent"
    raise LoginRefused(f"{who} lets nobody in: {tried}", cure=f"ssh-copy-id -p {destination.port} {who}")


def _keys(destination: Destination) -> Iterator[tuple[str, Callable[[], paramiko.PKey]]]:
    """The keys to try, in OpenSSH's order: the agent's (only the named ones under IdentitiesOnly), then files."""
    named = {_public_blob(path) for path in destination.identity_files}
    for key in paramiko.Agent().get_keys():
        if destination.agent or key.asbytes() in named:
            yield f"the agent's {key.fingerprint}", partial(_same, key)
    for path in destination.identity_files:
        yield str(path), partial(paramiko.PKey.from_path, path)


def _same(key: paramiko.PKey) -> paramiko.PKey:
    return key


def _public_blob(private: Path) -> bytes:
    with contextlib.suppress(OSError, IndexError, ValueError):
        return base64.b64decode(private.with_name(private.name + ".pub").read_text().split()[1])
    return b""


def _exchange_keys(
    destination: Destination, *, known: KnownHosts, chain: list[paramiko.Transport]
) -> HostKey:
    """Open a transport to the robot's sshd, add it to ``chain``, and return the host key it proved to own."""
    where = f"{destination.host}:{destination.port}"
    sock = _route(destination, known=known, chain=chain)
    try:
        transport = _Transport(sock)
        chain.append(transport)
        transport.daemon = True
        transport.banner_timeout = transport.auth_timeout = transport.channel_timeout = CONNECT
        if kinds := _algorithms(known.kinds(destination.known_as)):
            # Ask for a type we know: a host with several keys would else look like another host (paramiko #2411).
            options = transport.get_security_options()
            options.key_types = (*kinds, *(kind for kind in options.key_types if kind not in kinds))
        transport.start_client(timeout=CONNECT)
    except _DROPPED as problem:
        raise Unreachable(
            f"{where} answers, but not as an SSH server: {problem or 'it hung up'}"
        ) from problem
    key = transport.get_remote_server_key()
    return HostKey(kind=key.get_name(), blob=key.asbytes())


def _algorithms(kinds: tuple[str, ...]) -> tuple[str, ...]:
    """Key types as ``known_hosts`` names them, as the algorithms that prove them (RFC 8332 for RSA)."""
    pairs = (("rsa-sha2-512", "rsa-sha2-256") if kind == "ssh-rsa" else (kind,) for kind in kinds)
    able = paramiko.Transport._key_info  # type: ignore[attr-defined]  # noqa: SLF001  has no public name
    return tuple(name for pair in pairs for name in pair if name in able)


def _route(destination: Destination, *, known: KnownHosts, chain: list[paramiko.Transport]) -> Stream:
    """A byte stream to the robot's sshd: straight, through jump hosts (logging in to each), or by a ProxyCommand."""
    if destination.proxy_command:
        return paramiko.ProxyCommand(destination.proxy_command)
    if not destination.jumps:
        return tcp.connect(destination.host, destination.port, patience=CONNECT, silence=SILENCE)
    *before, last = destination.jumps
    jump = sshconfig.ask((), last if "://" in last else f"ssh://{last}")
    _log_in(replace(jump, jumps=(*before, *jump.jumps)), known=known, chain=chain)
    try:
        target = (destination.host, destination.port)
        return chain[-1].open_channel("direct-tcpip", target, ("127.0.0.1", 0), timeout=CONNECT)
    except (paramiko.SSHException, EOFError) as problem:
        raise Unreachable(
            f"the jump host {last} cannot reach {target[0]}:{target[1]}: {problem}"
        ) from problem
