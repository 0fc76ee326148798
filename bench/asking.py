"""How long do questions take: `fab status` over many robots beside a bare Paramiko pool, and `fab --list`?"""

from __future__ import annotations

import contextlib
import getpass
import json
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench import barepool
from bench.pairs import Cost, compare, spend
from fleet.robot import probe
from tests.support.homes import identity
from tests.support.sshd import Sshds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from bench.pairs import Pairs
    from tests.support.sshd import Sshd

FAB = str(Path(sys.executable).with_name("fab"))


@dataclass(frozen=True, kw_only=True)
class Servers:
    """SSH servers on loopback, as an inventory for `fab` and as a list for the bare pool."""

    inventory: Path
    ports: Path
    environment: Mapping[str, str]

    def compare(self, *, rounds: int, within: float = float("inf")) -> Pairs:
        """Ask all of them the same: each way is a whole process, from its start to its end."""
        return compare(self._fleet, self._bare, rounds=rounds, within=within)

    def _fleet(self) -> Cost:
        command = (FAB, "status", "--json", "--inventory", str(self.inventory))
        cost, said = spend(command, environment=self.environment)
        unreached = [name for name, robot in json.loads(said).items() if not robot["reachable"]]
        if unreached:
            raise RuntimeError(f"fab status did not reach {', '.join(unreached)}")
        return cost

    def _bare(self) -> Cost:
        command = (sys.executable, str(Path(barepool.__file__)), str(self.ports))
        cost, said = spend(command, environment=self.environment)
        if not all(f"{probe.MARK} end" in answer for answer in json.loads(said)):
            raise RuntimeError("the bare pool did not get all answers")
        return cost


@contextlib.contextmanager
def servers(count: int, *, folder: Path, environment: Mapping[str, str]) -> Iterator[Servers]:
    """So many real sshd on this computer, all of the person who runs this; ended afterwards."""
    started = Sshds(folder)
    programs = _programs(folder)
    try:
        many = tuple(
            started.start(name, options=(f'SetEnv SHLVL=2 "PATH={identity(folder, name)}:{programs}"',))
            for name in (f"pi{number}" for number in range(1, count + 1))
        )
        yield Servers(inventory=_inventory(many, folder), ports=_ports(many, folder), environment=environment)
    finally:
        started.stop()


def listing(*, environment: Mapping[str, str], rounds: int) -> tuple[Cost, ...]:
    """`fab --list`, again and again, after once that does not count."""
    runs = [spend((FAB, "--list"), environment=environment)[0] for _ in range(rounds + 1)]
    return tuple(runs[1:])


def _programs(folder: Path) -> Path:
    """All programs of this computer but Docker: one engine that answers for 50 robots is all that would be measured."""
    programs = folder / "programs"
    programs.mkdir()
    for path in (path for place in ("/usr/bin", "/usr/sbin") for path in Path(place).iterdir()):
        if path.name != "docker" and not (programs / path.name).is_symlink():
            (programs / path.name).symlink_to(path)
    return programs


def _inventory(many: tuple[Sshd, ...], folder: Path) -> Path:
    robots = {one.name: {"address": one.address, "port": one.port} for one in many}
    defaults = {"user": getpass.getuser(), "identity_file": str(many[0].identity)}
    whole = {"known_hosts": str(many[0].known_hosts), "defaults": defaults, "robots": robots}
    path = folder / "inventory.yaml"
    path.write_text(json.dumps(whole), encoding="utf-8")
    return path


def _ports(many: tuple[Sshd, ...], folder: Path) -> Path:
    command = shlex.join(("timeout", "-k", "5", "30", *probe.command()))
    ports = [one.port for one in many]
    asked = {"command": command, "user": getpass.getuser(), "key": str(many[0].identity), "ports": ports}
    path = folder / "ports.json"
    path.write_text(json.dumps(asked), encoding="utf-8")
    return path
