"""Real OpenSSH servers on 127.0.0.1, run as the current user, each with its own port and host keys."""

from __future__ import annotations

import base64
import contextlib
import getpass
import os
import signal
import socket
import subprocess
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from fleet.config.inventory import Robot
from fleet.ssh import connect
from fleet.ssh import known_hosts as hostkeys
from fleet.ssh.known_hosts import HostKey

SSHD = "/usr/sbin/sshd"

_USUAL = """\
PasswordAuthentication no
KbdInteractiveAuthentication no
PermitRootLogin yes
UsePAM no
StrictModes no
PidFile none
MaxStartups 500
SetEnv SHLVL=2
"""
"""SHLVL keeps bash from reading the .bashrc of whoever runs the tests, which may take long and print."""


@dataclass(frozen=True, kw_only=True)
class Sshd:
    """One running server. ``identity`` is a key it accepts; ``host_keys`` are its public ones, by type."""

    name: str
    address: str
    port: int
    log: Path
    identity: Path
    known_hosts: Path
    host_keys: dict[str, HostKey]
    process: subprocess.Popen[bytes]
    running: list[Sshd] = field(default_factory=list, repr=False, compare=False)
    """All servers to end with the test; one that is started again adds itself."""

    @property
    def known_as(self) -> str:
        return hostkeys.host_name(self.address, self.port)

    def robot(
        self, *, identity: Path | None = None, address: str = "", known_hosts: Path | None = None
    ) -> Robot:
        """The robot that this server stands for. By another address, OpenSSH's configuration has port and login."""
        return Robot(
            name=self.name,
            address=address or self.address,
            user=None if address else getpass.getuser(),
            port=None if address else self.port,
            identity_file=identity or (None if address else self.identity),
            known_hosts=known_hosts or self.known_hosts,
        )

    def trust(self) -> None:
        """Record its host keys, all types."""
        with self.known_hosts.open("a", encoding="utf-8") as file:
            file.writelines(known_line(self.known_as, key) for key in self.host_keys.values())

    def processes(self) -> list[int]:
        """Its process and all that it started."""
        parents: dict[int, int] = {}
        for entry in Path("/proc").glob("[0-9]*/stat"):
            try:
                parents[int(entry.parent.name)] = int(entry.read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue  # ended meanwhile
        found = [self.process.pid]
        for pid in found:
            found += [child for child, parent in parents.items() if parent == pid]
        return found

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to all of it: SIGSTOP makes a robot that is there and does nothing."""
        for pid in self.processes():
            with contextlib.suppress(ProcessLookupError):  # ended meanwhile
                os.kill(pid, number)

    def stop(self) -> None:
        """End it, with its connections."""
        self.signal(signal.SIGKILL)
        self.process.wait()

    def again(self) -> Sshd:
        """One that was stopped, as it was: where it listened, with its keys. It listens when this returns."""
        listens = self.log.read_text().count("Server listening")
        process = subprocess.Popen(self.process.args, start_new_session=True)
        restarted = replace(self, process=process)
        self.running.append(restarted)
        while process.poll() is None and self.log.read_text().count("Server listening") == listens:
            time.sleep(0.002)
        return restarted


class Sshds:
    """Starts servers that share a client key and a known_hosts file; ends them all."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.known_hosts = folder / "known_hosts"
        self.identity = make_key(folder / "id")
        self.config = folder / "ssh_config"
        self.configure("")
        self._running: list[Sshd] = []
        if os.geteuid() == 0:
            Path("/run/sshd").mkdir(exist_ok=True)  # sshd wants it where it runs as root

    def configure(self, text: str) -> None:
        """Write the OpenSSH client configuration that tests use in place of the person's."""
        usual = "Host *\n  UserKnownHostsFile none\n  GlobalKnownHostsFile none\n  IdentityFile none\n"
        self.config.write_text(text + "\n" + usual, encoding="utf-8")

    def start(
        self,
        name: str = "pi",
        *,
        options: tuple[str, ...] = (),
        host_keys: tuple[str, ...] = ("ed25519",),
        trusted: bool = True,
        address: str = "127.0.0.1",
        within: tuple[str, ...] = (),
    ) -> Sshd:
        """Start one; ``within`` goes before its command (``ip netns exec ...``). It listens when this returns."""
        for _ in range(5):
            launched = self._launch(name, options=options, kinds=host_keys, address=address, within=within)
            if self._listens(launched, trusted=trusted):
                return launched
        raise RuntimeError(launched.log.read_text())

    def start_many(self, count: int) -> tuple[Sshd, ...]:
        """Start many at once: ``pi1``, ``pi2``, ...; about 5 ms each."""
        names = [f"pi{number}" for number in range(1, count + 1)]
        launched = [
            self._launch(name, options=(), kinds=("ed25519",), address="127.0.0.1", within=())
            for name in names
        ]
        return tuple(one if self._listens(one, trusted=True) else self.start(one.name) for one in launched)

    def log_in(self, server: Sshd, *, identity: Path | None = None) -> str:
        """Log in and run `echo in`; its answer."""
        with connect.connect(server.robot(identity=identity), config=self.config) as session:
            return session.run(("echo", "in")).output

    def stop(self) -> None:
        """End them all."""
        for running in self._running:
            if running.process.poll() is None:
                running.stop()
        self._running.clear()

    def _launch(
        self,
        name: str,
        *,
        options: tuple[str, ...],
        kinds: tuple[str, ...],
        address: str,
        within: tuple[str, ...],
    ) -> Sshd:
        folder = self.folder / name
        folder.mkdir(exist_ok=True)
        keys = {kind: make_key(self.folder / f"host_{kind}", kind=kind) for kind in kinds}
        port = free_port() if not within else 22
        chosen = {
            option.split()[0] for option in options
        }  # the first of two wins, except where the last does
        usual = [line for line in _USUAL.splitlines() if line.split()[0] not in chosen]
        own = [
            *options,
            *usual,
            f"ListenAddress {address}:{port}",
            *(f"HostKey {key}" for key in keys.values()),
        ]
        config = folder / "sshd_config"
        config.write_text("\n".join((*own, f"AuthorizedKeysFile {self.identity}.pub", "")), encoding="utf-8")
        log = folder / "log"
        log.unlink(missing_ok=True)
        command = (*within, SSHD, "-D", "-f", str(config), "-E", str(log))
        process = subprocess.Popen(command, start_new_session=True)
        return Sshd(
            name=name,
            address=address,
            port=port,
            log=log,
            identity=self.identity,
            known_hosts=self.known_hosts,
            host_keys={kind: public_key(key) for kind, key in keys.items()},
            process=process,
            running=self._running,
        )

    def _listens(self, launched: Sshd, *, trusted: bool) -> bool:
        while launched.process.poll() is None:
            if launched.log.exists() and "Server listening" in launched.log.read_text():
                self._running.append(launched)
                if trusted:
                    launched.trust()
                return True
            time.sleep(0.002)
        return False


def make_key(path: Path, *, kind: str = "ed25519", passphrase: str = "") -> Path:
    """A key pair, made if it is not there."""
    if not path.exists():
        command = ("ssh-keygen", "-q", "-t", kind, "-N", passphrase, "-C", path.name, "-f", str(path))
        subprocess.run(command, check=True)
    return path


def public_key(path: Path) -> HostKey:
    """The public half of a key pair."""

    kind, blob = path.with_name(path.name + ".pub").read_text(encoding="utf-8").split()[:2]
    return HostKey(kind=kind, blob=base64.b64decode(blob))


def known_line(name: str, key: HostKey) -> str:
    """A line for a known_hosts file."""

    return f"{name} {key.kind} {base64.b64encode(key.blob).decode()}\n"


def free_port() -> int:
    """A port nobody listens on at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
