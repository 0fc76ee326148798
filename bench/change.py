"""How long does it take from one changed line of a node to robots that run it? As a time line, with three ways to do it.

The ways share the robots. Before each run the way's own previous version is running, and the line is changed again, so
every run has one new layer to bring. The robots and this computer have one clock, so their events fit into one line.
"""

from __future__ import annotations

import argparse
import calendar
import contextlib
import json
import os
import random
import shlex
import statistics
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bench.pairs import spend
from bench.ways import FAB, registry
from fleet.images.docker_cli import docker, docker_or_none
from fleet.images.emulation import desktop_platform
from fleet.images.image import tagged_for
from fleet.lab import lifecycle
from fleet.starter import example
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from fleet.lab.virtual_pi import VirtualPi

NAME = "fleetbench-change"
WAYS = ("fab", "save", "registry")
PHASES = (
    *("build", "begin", "probe", "out of Docker", "bytes", "load"),
    *("stop", "start", "first message", "done"),
)
"""The parts of a run, in order. What a way cannot tell apart is in the next part that it can."""

BALLAST = 500_000_000
"""Bytes that the large image has more than the talker's 210 MB, in a layer below the code."""

TAKES = 600.0  # seconds for one command

_LINES = (
    ("begin", "look at the robot"),
    ("probe", "prepare what it lacks"),
    ("out of Docker", "write release"),
    ("bytes", "load the image into Docker"),
    ("load", "start release"),
)
"""How `fab ship` tells that a part has ended, by the step that comes next. The first is for all robots at once."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the person wants measured: robots at once, and rounds for a single one."""

    robots: int
    rounds: int


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """One run: when each part had ended on the robot that was last, in seconds since the line was changed."""

    ends: Mapping[str, float]

    @property
    def parts(self) -> dict[str, float]:
        """The seconds of each part."""
        there = [(phase, self.ends[phase]) for phase in PHASES if phase in self.ends]
        begins = (0.0, *(end for _, end in there))
        return {phase: end - begin for (phase, end), begin in zip(there, begins, strict=False)}

    @property
    def shipped(self) -> float:
        """Seconds from the end of the build until the way has ended and every robot has sent a message."""
        return self.ends["done"] - self.ends["build"]

    @property
    def least(self) -> float:
        """Seconds from the signal to stop until the first message."""
        return self.ends["first message"] - self.ends["load"]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is shipped to how many robots."""

    title: str
    stack: str
    robots: int


@dataclass(kw_only=True)
class Measured:
    """All runs, by scene and way; the way ``limit`` stops and starts by hand what is there already.

    ``unfinished`` says why not all was measured.
    """

    scenes: tuple[Scene, ...]
    runs: dict[tuple[str, str], list[Timeline]] = field(default_factory=dict)
    engine: str = ""
    unfinished: str = ""
    sizes: dict[str, int] = field(default_factory=dict)

    def median(self, scene: Scene, way: str) -> Timeline | None:
        """The run that took the median time."""
        runs = sorted(self.runs.get((scene.title, way), ()), key=lambda run: run.shipped)
        return runs[(len(runs) - 1) // 2] if runs else None

    def beyond(self, scene: Scene) -> float:
        """The median of the seconds that `fab ship` took beyond the limit of the same round."""
        pairs = zip(self.runs[scene.title, "fab"], self.runs[scene.title, "limit"], strict=True)
        return statistics.median(fab.shipped - limit.least for fab, limit in pairs)

    def ratio(self, scene: Scene, way: str) -> float:
        """The median of how many times as long as `fab ship` a way took in the same round."""
        pairs = zip(self.runs[scene.title, way], self.runs[scene.title, "fab"], strict=True)
        return statistics.median(usual.shipped / fab.shipped for usual, fab in pairs)


def asked(arguments: Sequence[str]) -> Asked:
    """The options of `make bench-change`."""
    parser = argparse.ArgumentParser(prog="python -m bench change")
    parser.add_argument("--robots", type=int, default=20, help="so many in the scene with many robots")
    parser.add_argument("--rounds", type=int, default=3, help="rounds with a single robot")
    chosen = parser.parse_args(arguments)
    return Asked(robots=chosen.robots, rounds=chosen.rounds)


def measure(
    wanted: Asked, *, folder: Path, environment: Mapping[str, str], say: Callable[[str], None]
) -> Measured:
    """Measure all scenes. Raises ``RuntimeError`` or ``FleetError`` with what this computer lacks for it."""
    many = Scene(title=f"{wanted.robots} robots", stack="small", robots=wanted.robots)
    one, large = (
        Scene(title="1 robot", stack="small", robots=1),
        Scene(title="1 robot, an image of 700 MB", stack="large", robots=1),
    )
    measured = Measured(scenes=(one, *((many,) if wanted.robots > 1 else ()), large))
    try:
        with _bench(wanted.robots, folder=folder, environment=environment, say=say) as bench:
            measured.engine = bench.on(bench.pis[0], "docker version --format '{{.Server.Version}}'")
            for scene in measured.scenes:
                _measure(scene, bench, wanted, measured, say=say)
    except TimeoutError as over:
        if not measured.runs:
            raise
        measured.unfinished = str(over)
        say(f"ended early: {over}")
    return measured


def _measure(
    scene: Scene, bench: _Bench, wanted: Asked, measured: Measured, *, say: Callable[[str], None]
) -> None:
    """Measure one scene; a round counts when all its ways are through."""
    bench.begin(scene)
    measured.sizes[scene.stack] = int(docker("image", "inspect", "--format", "{{.Size}}", bench.image(scene)))
    for turn in range(wanted.rounds if scene.robots == 1 else 1):
        runs = {}
        for way in ("limit", *WAYS):
            runs[way] = bench.run(scene, way)
            say(f"{scene.title}, round {turn + 1}, {way}: {_told(runs[way])}")
        for way, run in runs.items():
            measured.runs.setdefault((scene.title, way), []).append(run)
    bench.end(scene)


def _told(run: Timeline) -> str:
    return ", ".join(f"{phase} {seconds:.1f} s" for phase, seconds in run.parts.items())


@contextlib.contextmanager
def _bench(
    count: int, *, folder: Path, environment: Mapping[str, str], say: Callable[[str], None]
) -> Iterator[_Bench]:
    """Virtual Pis with Docker, a project for each stack, and a registry; all removed afterwards."""
    directory = folder / "lab"
    lifecycle.down(directory=directory, name=NAME, say=lambda _: None)  # what a killed run left
    port = free_port()
    try:
        lifecycle.up(count, directory=directory, name=NAME, say=say)
        inventory = directory / "inventory.yaml"
        text = inventory.read_text(encoding="utf-8").replace(lifecycle.WANTED, desktop_platform())
        inventory.write_text(text, encoding="utf-8")
        bench = _Bench(
            folder=folder, pis=lifecycle.list_(name=NAME), port=port, environment=environment, say=say
        )
        bench.write_projects()
        for verb in (("trust", "--yes"), ("provision",)):
            say(f"fab {verb[0]}")
            bench.fab("small", *verb)
        with registry(port=port, folder=folder, say=say):
            yield bench
    finally:
        _forget(port)
        lifecycle.down(directory=directory, name=NAME, say=say)


def _forget(port: int) -> None:
    """Remove the images of this bench from this computer, those of earlier rounds too, which have only a digest."""
    for stack in ("small", "large"):
        docker_or_none("image", "rm", tagged_for(f"{NAME}-{stack}", desktop_platform()))
        pushed = f"localhost:{port}/{NAME}-{stack}"
        form = "{{.Repository}}@{{.Digest}}"
        for name in docker("image", "ls", "--digests", "--format", form, pushed).split():
            docker_or_none("image", "rm", name)
        docker_or_none("image", "rm", pushed)


@dataclass(frozen=True, kw_only=True)
class _Bench:
    folder: Path
    pis: Sequence[VirtualPi]
    port: int
    environment: Mapping[str, str]
    say: Callable[[str], None]

    def image(self, scene: Scene) -> str:
        return tagged_for(f"{NAME}-{scene.stack}", desktop_platform())

    def pushed(self, scene: Scene) -> str:
        return f"localhost:{self.port}/{NAME}-{scene.stack}"

    def write_projects(self) -> None:
        """The example of fleet, and the same on top of ballast."""
        project = self.folder / "project"
        for name, path in example.files().items():
            (project / name).parent.mkdir(parents=True, exist_ok=True)
            (project / name).write_bytes(path.read_bytes())
            (project / name).chmod(path.stat().st_mode)
        compose = project / "docker" / "compose.yaml"
        text = compose.read_text(encoding="utf-8")
        compose.write_text(text.replace("image: talker", f"image: {NAME}-small"), encoding="utf-8")
        large = compose.with_name("large.yaml")
        text = text.replace("image: talker", f"image: {NAME}-large")
        large.write_text(text.replace("docker/Dockerfile", "docker/large.Dockerfile"), encoding="utf-8")
        # The last stage begins with the ballast, and so ends with the layer of the code, as before.
        recipe = (project / "docker" / "Dockerfile").read_text(encoding="utf-8")
        head, last = recipe.rsplit("\nFROM ros-base\n", 1)
        heavy = f"{head}\nFROM ros-base\nCOPY ballast /ballast\n{last}"
        large.with_name("large.Dockerfile").write_text(heavy, encoding="utf-8")
        (project / ".dockerignore").unlink(missing_ok=True)
        with (project / "ballast").open("wb") as ballast:
            generator = random.Random(1)  # noqa: S311  the same each time, and half as large when packed
            for _ in range(BALLAST // 2_000_000):
                ballast.write(generator.randbytes(1_000_000) + bytes(1_000_000))
        for stack, file in (("small", "compose.yaml"), ("large", "large.yaml")):
            whole = {"stack": f"docker/{file}", "include": [{"path": "../lab/inventory.yaml"}]}
            (project / f"{stack}.yaml").write_text(json.dumps(whole), encoding="utf-8")

    def fab(self, stack: str, *arguments: str) -> None:
        argv = (FAB, *arguments, "--inventory", str(self.folder / "project" / f"{stack}.yaml"))
        spend(argv, environment=self.environment, limit=TAKES)

    def on(self, pi: VirtualPi, script: str) -> str:
        """Run a script as root, past SSH."""
        return docker("exec", pi.container, "sh", "-c", script, timeout=TAKES)

    def on_each(self, pis: Sequence[VirtualPi], script: str) -> list[str]:
        with ThreadPoolExecutor(len(pis)) as pool:
            return list(pool.map(lambda pi: self.on(pi, script), pis))

    def chosen(self, scene: Scene) -> Sequence[VirtualPi]:
        return self.pis[: scene.robots]

    def begin(self, scene: Scene) -> None:
        """Let each way bring a first version, which is not measured."""
        self.say(f"{scene.title}: the first version, by each way")
        self._change(scene)
        for way in WAYS:
            self._stop_others(scene, "")
            for pi in self.chosen(scene):
                if way != "fab":
                    self._lay(pi, scene, way)
            self._ship(scene, way, since=time.time())

    def end(self, scene: Scene) -> None:
        """Leave nothing that runs or is released."""
        script = "docker ps -aq | xargs -r docker rm -f >/dev/null; rm -rf ~pi/.fleet ~pi/save ~pi/registry"
        self.on_each(self.chosen(scene), script)

    def run(self, scene: Scene, way: str) -> Timeline:
        """One run, from the change on; the way's previous version runs before."""
        self._stop_others(scene, "fab" if way == "limit" else way)
        os.sync()
        began = time.time()
        if way != "limit":
            self._change(scene)
        built = time.time()
        marks = self._ship(scene, way, since=built)
        return Timeline(ends={"build": built - began, **{name: at - began for name, at in marks.items()}})

    def _change(self, scene: Scene) -> None:
        """Change one line of the node, and build the image; all ways ship what this makes."""
        node = self.folder / "project" / "talker" / "nodes" / "talker"
        with node.open("a", encoding="utf-8") as text:
            text.write(f"# {time.time_ns()}\n")
        self.fab(scene.stack, "build", "--hosts", "pi1")

    def _stop_others(self, scene: Scene, way: str) -> None:
        """Let only a way's own containers run, until they have sent a message."""
        project = {"fab": "talker", "": "none"}.get(way, way)
        self.on_each(
            self.chosen(scene),
            "docker ps -q | xargs -r docker stop >/dev/null;"
            f" ids=$(docker ps -aq --filter label=com.docker.compose.project={project});"
            ' [ -n "$ids" ] || exit 0; docker start $ids >/dev/null;'
            " for _ in $(seq 100); do"
            " docker exec $ids python3 -IS /usr/local/lib/fleet/tcpros.py time --timeout 10 >/dev/null 2>&1 && exit 0;"
            " sleep 0.3; done; exit 1",
        )

    def _lay(self, pi: VirtualPi, scene: Scene, way: str) -> None:
        """A person's own Compose project on the robot, beside fleet's."""
        image = self.image(scene) if way == "save" else self.pushed(scene)
        text = (self.folder / "project/docker/compose.yaml").read_text(encoding="utf-8")
        text = text.replace(f"image: {NAME}-small", f"image: {image}").replace("name: talker", f"name: {way}")
        values = f"ROS_MASTER_URI=http://localhost:11311\nROS_HOSTNAME={pi.address}\n"
        script = f"install -d -o pi ~pi/{way} ~pi/{way}/files && cd ~pi/{way} && printf %s {shlex.quote(text)} > compose.yaml"
        self.on(pi, f"{script} && printf %s {shlex.quote(values)} > .env")

    def _ship(self, scene: Scene, way: str, *, since: float) -> dict[str, float]:
        """Bring the image and start it; when each part had ended on the robot whose first message was last."""
        pis = self.chosen(scene)
        marks = self._fab_ship(scene) if way == "fab" else self._by_hand(scene, way)
        done = time.time()
        seen = dict(zip((pi.name for pi in pis), self.on_each(pis, _events(since)), strict=True))
        runs = {name: {**marks[name], **read_events(text)} for name, text in seen.items()}
        last = max(runs.values(), key=lambda ends: ends["first message"])
        stopping = last.pop("stopping")
        if way == "limit":
            last["load"] = stopping
        return {**last, "done": max(done, last["first message"])}

    def _fab_ship(self, scene: Scene) -> dict[str, dict[str, float]]:
        """`fab ship`, read line by line as it prints them."""
        names = [pi.name for pi in self.chosen(scene)]
        inventory = str(self.folder / "project" / f"{scene.stack}.yaml")
        argv = (FAB, "ship", "--hosts", ",".join(names), "--inventory", inventory)
        lines: list[tuple[float, str]] = []
        with subprocess.Popen(
            argv, env=self.environment, stdin=-3, stdout=-1, stderr=-2, text=True, cwd=self.folder / "project"
        ) as process:
            assert process.stdout
            lines += ((time.time(), line) for line in process.stdout)
        if process.returncode:
            raise RuntimeError(f"fab ship: {''.join(line for _, line in lines)[-600:]}")
        return {name: told(lines, name) for name in names}

    def _by_hand(self, scene: Scene, way: str) -> dict[str, dict[str, float]]:
        """The usual ways, each a line of shell; the robots side by side."""
        pis, image, pushed = self.chosen(scene), self.image(scene), self.pushed(scene)
        marks: dict[str, dict[str, float]] = {pi.name: {} for pi in pis}
        if way == "registry":
            self._shell(f"docker tag {image} {pushed} && docker push -q {pushed}")
            for ends in marks.values():
                ends["out of Docker"] = time.time()

        def bring(pi: VirtualPi) -> None:
            match way:
                case "save":
                    self._shell(f"docker save {image} | {self._ssh(pi)} docker load -q")
                case "registry":
                    tunnel = self._ssh(pi, "-R", f"{self.port}:localhost:{self.port}")
                    self._shell(f"{tunnel} docker pull -q {pushed}")
            if way != "limit":
                marks[pi.name]["load"] = time.time()
            start = {
                "limit": "cd .fleet/stacks/talker/current && docker compose -p talker up -d --force-recreate",
                "save": "cd save && docker compose up -d",
                "registry": "cd registry && docker compose up -d --wait",
            }
            self._shell(f"{self._ssh(pi)} {shlex.quote(start[way])}")

        with ThreadPoolExecutor(len(pis)) as pool:
            list(pool.map(bring, pis))
        return marks

    def _shell(self, line: str) -> None:
        spend(("bash", "-o", "pipefail", "-c", line), environment=self.environment, limit=TAKES)

    def _ssh(self, pi: VirtualPi, *options: str) -> str:
        lab = self.folder / "lab"
        known = ("-o", f"UserKnownHostsFile={lab / 'known_hosts'}", "-o", "BatchMode=yes")
        return shlex.join(
            ("ssh", "-F", "none", *known, "-i", str(lab / "id_ed25519"), *options, f"pi@{pi.address}")
        )


def _events(since: float) -> str:
    """A script that prints when containers were stopped and started, and the lines of the one that runs, when it does.

    The events of this second count too, so it is waited for.
    """
    return (
        f"for _ in $(seq 200); do docker logs -t $(docker ps -q | head -n 1) 2>&1 | grep -q INFO && break; sleep 0.1; done;"
        f" docker events --since {since:.3f} --until $(($(date +%s) + 1)) --filter type=container"
        " --format '{{.TimeNano}} {{.Action}} {{.ID}}' | sed 's/:.*//';"
        " echo now $(docker ps -q --no-trunc); docker logs -t $(docker ps -q | head -n 1) 2>&1 | grep INFO | head -n 1"
    )


def read_events(text: str) -> dict[str, float]:
    """When the old container began to stop and was stopped, the new one was started, and its first message came."""
    *events, now, first = text.splitlines()
    new = now.split()[1]
    at: dict[str, float] = {}
    for line in events:
        nanoseconds, action, *whose = line.split()
        mine = whose == [new]
        name = {("kill", False): "stopping", ("die", False): "stop", ("start", True): "start"}.get(
            (action, mine)
        )
        if name == "stopping":
            at.setdefault(name, int(nanoseconds) / 1e9)
        elif name:
            at[name] = int(nanoseconds) / 1e9
    at.setdefault("stopping", at["start"])
    return {**at, "first message": _seconds(first.split()[0])}


def _seconds(stamp: str) -> float:
    """Docker's time stamp, such as 2026-11-28T11:48:51.773920767Z, as seconds since 1970."""
    whole, _, fraction = stamp.rstrip("Z").partition(".")
    return calendar.timegm(time.strptime(whole, "%Y-%m-%dT%H:%M:%S")) + float(f"0.{fraction or 0}")


def told(lines: Sequence[tuple[float, str]], robot: str) -> dict[str, float]:
    """When the parts of `fab ship` had ended for a robot, by the lines that it printed and when."""
    ends: dict[str, float] = {}
    for at, line in lines:
        who, _, title = line.partition(": ")
        if who != robot and not (
            title.startswith("look at") and who.partition(" ")[2] in ("robot", "robots")
        ):
            continue
        for phase, begin in _LINES:
            if title.startswith(begin):
                ends.setdefault(phase, at)
    return ends
