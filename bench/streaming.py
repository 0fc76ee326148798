"""How fast does an image reach robots, beside ``docker save | ssh docker load``? On virtual Pis of its own lab."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench.pairs import ROOT, Cost, compare, spend
from fleet.images.docker_cli import docker, docker_or_none
from fleet.images.image import tagged_for
from fleet.lab import lifecycle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from bench.pairs import Pairs
    from fleet.lab.virtual_pi import VirtualPi

NAME = "fleetbench"
REFERENCE = f"{NAME}:image"
"""What the image is called while it is sent, here and on the robots."""

LOAD = ("docker", "load", "--quiet")
SINK = ("sh", "-c", "cat > /dev/null")
FAB = str(Path(sys.executable).with_name("fab"))


@dataclass(frozen=True, kw_only=True)
class Robots:
    """The virtual Pis, with Docker on them, and the image to send."""

    folder: Path
    pis: tuple[VirtualPi, ...]
    image: str
    environment: Mapping[str, str]

    def compare(self, command: Sequence[str], *, count: int, rounds: int, within: float) -> Pairs:
        """Stream the image into ``command`` on so many robots at once: fleet's way and OpenSSH's; see `pairs.compare`."""
        pis = self.pis[:count]
        return compare(
            lambda: self._fresh(self._fleet, command, pis),
            lambda: self._fresh(self._openssh, command, pis),
            rounds=rounds,
            within=within,
        )

    def engine(self) -> str:
        """The version of Docker on the robots."""
        return self._on(self.pis[0], "docker", "version", "--format", "{{.Server.Version}}")

    def _fresh(
        self,
        way: Callable[[Sequence[str], Sequence[VirtualPi]], Cost],
        command: Sequence[str],
        pis: Sequence[VirtualPi],
    ) -> Cost:
        """One run, with what earlier ones wrote on the disk already, and its image gone afterwards."""
        os.sync()
        cost = way(command, pis)
        for pi in pis if command == LOAD else ():
            self._on(pi, "docker", "image", "rm", REFERENCE)  # fails where nothing was loaded
        return cost

    def _fleet(self, command: Sequence[str], pis: Sequence[VirtualPi]) -> Cost:
        inventory = (
            "--inventory",
            str(self.folder / "inventory.yaml"),
            "--hosts",
            ",".join(p.name for p in pis),
        )
        what = ("--image", self.image, "--reference", REFERENCE)
        sender = (sys.executable, "-m", "bench.sender", *inventory, *what, "--", *command)
        return Cost(**json.loads(spend(sender, environment=self.environment)[1]))

    def _openssh(self, command: Sequence[str], pis: Sequence[VirtualPi]) -> Cost:
        pipes = [f"docker save {REFERENCE} | {self._ssh(pi, command)}" for pi in pis]
        return spend(*(("sh", "-c", pipe) for pipe in pipes), environment=self.environment)[0]

    def _on(self, pi: VirtualPi, *argv: str) -> str:
        return spend(("sh", "-c", self._ssh(pi, argv)), environment=self.environment)[1].strip()

    def _ssh(self, pi: VirtualPi, argv: Sequence[str]) -> str:
        known = self.folder / "lab" / "known_hosts"
        options = ("-F", "none", "-o", "BatchMode=yes", "-o", f"UserKnownHostsFile={known}")
        key = ("-i", str(self.folder / "lab" / "id_ed25519"))
        return shlex.join(("ssh", *options, *key, f"pi@{pi.address}", shlex.join(argv)))


@contextlib.contextmanager
def robots(
    count: int, *, folder: Path, environment: Mapping[str, str], say: Callable[[str], None]
) -> Iterator[Robots]:
    """So many virtual Pis, with Docker; removed afterwards. What they stream is the talker's image, built if need be."""
    directory = folder / "lab"
    lifecycle.down(directory=directory, name=NAME, say=lambda _: None)  # what a killed run left
    try:
        lifecycle.up(count, directory=directory, name=NAME, say=say)
        pis = lifecycle.list_(name=NAME)
        fleet = {"stack": str(ROOT / "docker/compose.yaml"), "include": [{"path": "lab/inventory.yaml"}]}
        inventory = folder / "inventory.yaml"
        inventory.write_text(json.dumps(fleet), encoding="utf-8")
        image = tagged_for("talker", pis[0].platform)
        missing = docker_or_none("image", "inspect", "--format", "{{.Id}}", image) is None
        for verb in (("trust", "--yes"), ("provision",), *[("build", "--hosts", "pi1")][:missing]):
            say(f"fab {verb[0]}")
            spend((FAB, *verb, "--inventory", str(inventory)), environment=environment, limit=300)
        docker("tag", image, REFERENCE)
        yield Robots(folder=folder, pis=pis, image=image, environment=environment)
    finally:
        docker_or_none("image", "rm", REFERENCE)
        lifecycle.down(directory=directory, name=NAME, say=say)
