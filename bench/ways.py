"""How do images get to a robot: with `fab ship`, and the ways people know? Each is one line of shell, run at the desk.

A run is watched from outside: what the emulated Wi-Fi counted, what the robot's processes wrote on its disk, and how
much memory either side took.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.images import NAME, cache
from bench.pairs import ROOT
from bench.watch import Watch, written
from fleet.images.docker_cli import docker

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Iterator, Mapping

    from fleet.lab.virtual_pi import VirtualPi
    from tests.support.wifi import Wifi

FAB = str(Path(sys.executable).with_name("fab"))
TRIES = 6
"""How often a person types the same line again after a link that was gone."""

WAYS = {
    "fab": "`fab ship`",
    "save": "`docker save \\| ssh docker load`",
    "gzip": "`docker save \\| gzip \\| ssh docker load`",
    "rsync": "`docker save`, `rsync -z`, `docker load`",
    "pull": "`fab ship`, pulled through SSH",
    "registry": "a registry and `docker pull`, through `ssh -R`",
}


_WIPE = """
docker ps --all --quiet | xargs --no-run-if-empty docker rm --force
docker image ls --all --quiet | sort --unique | xargs --no-run-if-empty docker image rm --force
docker system prune --all --force --volumes
rm -rf ~pi/.fleet ~pi/.cache ~pi/app.tar
"""


@dataclass(frozen=True, kw_only=True)
class Road:
    """One way to reach a robot: its address there, what a command that uses it begins with, and its inventory."""

    address: str
    inventory: Path
    inside: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Lane:
    """One robot that is measured: over the air, and put back over a road that costs nothing. ``over`` ends its runs."""

    pi: VirtualPi
    link: Wifi
    air: Road
    quick: Road
    folder: Path
    registry: int
    environment: Mapping[str, str]
    over: threading.Event

    def prepare(self, way: str, *, first: bool) -> None:
        """Leave nothing on the robot, or the first version as the same way brings it."""
        docker("exec", self.pi.container, "sh", "-c", _WIPE)
        if not first:
            self._run(self.script(way, "v1", self.quick), self.quick, limit=600)
        os.sync()

    def measure(
        self, way: str, variant: str, *, limit: float, outage: tuple[int, float] | None = None
    ) -> Run:
        """One run over the air; with an ``outage`` of seconds after so many bytes, repeated as a person would."""
        watch = Watch(link=self.link, pi=self.pi, outage=outage)
        before, on_disk = self.link.traffic(self.pi.name), written(self.pi)
        started, tries = time.monotonic(), 0
        with watch:
            while tries < TRIES:
                tries += 1
                script = self.script(way, variant, self.air)
                try:
                    self._run(script, self.air, limit=limit, watch=watch)
                except RuntimeError:
                    if not watch.happened or tries == TRIES:
                        raise
                else:
                    break
        seconds, after = time.monotonic() - started, self.link.traffic(self.pi.name)
        return Run(
            way=way,
            variant=variant,
            seconds=seconds,
            wire=after.bytes - before.bytes,
            payload=after.payload - before.payload,
            written=written(self.pi) - on_disk,
            robot_memory=watch.robot_peak,
            desk_memory=watch.desk_peak,
            speed=watch.speed,
            tries=tries,
        )

    def script(self, way: str, variant: str, road: Road) -> str:
        """The line of shell."""
        image, there = f"{NAME}:{variant}", f"localhost:{self.registry}/{NAME}:{variant}"
        file = self.folder / f"{self.pi.name}.tar"
        match way:
            case "save":
                return f"docker save {image} | {self.ssh(road)} docker load"
            case "gzip":
                return f"docker save {image} | gzip | {self.ssh(road)} docker load"
            case "rsync":
                to = f"pi@{road.address}:app.tar"
                copy = f"rsync --compress --rsh {shlex.quote(self.ssh(road, login=False))} {file} {to}"
                return f"docker save --output {file} {image}; {copy}; {self.ssh(road)} docker load --input app.tar"
            case "registry":
                tunnel = self.ssh(road, "-R", f"{self.registry}:localhost:{self.registry}")
                pull = shlex.quote(f"docker pull {there} && docker tag {there} {image}")
                return f"docker tag {image} {there}; docker push {there}; {tunnel} {pull}"
            case _:
                stack = road.inventory.with_name("compose.yaml")
                text = f"name: bench\nservices:\n  app:\n    image: {image}\n"
                ship = shlex.join((FAB, "ship", "--inventory", str(road.inventory), "--hosts", self.pi.name))
                return f"printf %s {shlex.quote(text)} > {stack}; {ship}"

    def ssh(self, road: Road, *options: str, login: bool = True) -> str:
        """OpenSSH's own client, to the robot."""
        known = ("-o", f"UserKnownHostsFile={self.folder / 'lab' / 'known_hosts'}")
        key = ("-i", str(self.folder / "lab" / "id_ed25519"))
        where = (f"pi@{road.address}",) if login else ()
        return shlex.join(("ssh", "-F", "none", "-o", "BatchMode=yes", *known, *key, *options, *where))

    def _run(self, script: str, road: Road, *, limit: float, watch: Watch | None = None) -> None:
        with tempfile.TemporaryFile("w+") as said:
            process = subprocess.Popen(
                (*road.inside, "bash", "-o", "pipefail", "-ec", script),
                cwd=ROOT,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            if watch:
                watch.session = process.pid
            try:
                code = self._wait(process, limit)
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            if code is None:
                raise RuntimeError(f"it took longer than {limit:g} s, or was ended")
            if code:
                said.seek(0)
                last = " / ".join(said.read().split("\n")[-4:]).replace(f"{self.folder}/", "")
                raise RuntimeError(f"it ended with code {code}: {last}")

    def _wait(self, process: subprocess.Popen[bytes], limit: float) -> int | None:
        """Its exit code; None where it takes longer, or nobody wants to know any more."""
        deadline = time.monotonic() + limit
        while time.monotonic() < deadline and not self.over.is_set():
            with contextlib.suppress(subprocess.TimeoutExpired):
                return process.wait(1)
        return None


@dataclass(frozen=True, kw_only=True)
class Run:
    """What one run cost. ``wire`` is all that went on the air; ``payload`` what TCP delivered to the robot of it.

    ``speed`` is in payload bytes a second, while they flowed. Memory is the robot's above what it was before, and that of
    all processes of the line at the desk together; the desk's Docker Engine is in neither.
    """

    way: str
    variant: str
    seconds: float
    wire: int
    payload: int
    written: int
    robot_memory: int
    desk_memory: int
    speed: float
    tries: int = 1


def renamed(run: Run, variant: str) -> Run:
    """The same run, as a variant of its own."""
    return replace(run, variant=variant)


@contextlib.contextmanager
def registries(link: Wifi, *, port: int, folder: Path, say: Callable[[str], None]) -> Iterator[None]:
    """The same registry twice: where this computer's Docker pushes to, and where the desk's tunnels end."""
    with contextlib.ExitStack() as stack:
        for inside in ((), link.at_desk()):
            stack.enter_context(registry(port=port, folder=folder, say=say, inside=inside))
        yield


@contextlib.contextmanager
def registry(
    *, port: int, folder: Path, say: Callable[[str], None], inside: tuple[str, ...] = ()
) -> Iterator[None]:
    """Debian's registry on loopback; ``inside`` is what a command begins with that runs it somewhere else."""
    program = _registry(say=say)
    settings = folder / "registry.yml"
    settings.write_text(
        "version: 0.1\nlog: {level: error}\n"
        f"storage: {{filesystem: {{rootdirectory: {folder / 'registry'}}}}}\n"
        f"http: {{addr: 'localhost:{port}'}}\n"
    )
    with subprocess.Popen(
        (*inside, program, "serve", str(settings)), stdin=-3, stdout=-3, stderr=-3, start_new_session=True
    ) as process:
        try:
            yield
        finally:
            process.terminate()


def _registry(*, say: Callable[[str], None]) -> str:
    """Debian's registry; unpacked, not installed, where it is missing: the package would start one at once."""
    folder = cache() / "bench-registry"
    program = folder / "usr" / "bin" / "docker-registry"
    if not program.exists():
        say("downloading Debian's docker-registry (once)")
        folder.mkdir(parents=True, exist_ok=True)
        script = (
            "apt-get -q download docker-registry && dpkg-deb --extract docker-registry_*.deb . && rm *.deb"
        )
        done = subprocess.run(("sh", "-c", script), cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"no docker-registry from Debian: {done.stderr.strip()}")
    return str(program)
