"""A person's folder with a fleet in it, and the real `fab` run there: what the tests on virtual Pis share."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

from fleet.transfer import codec
from fleet.transfer.load_archive import INCOMING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    from tests.lab.conftest import Lab, Pi

    T = TypeVar("T")

ROOT = Path(__file__).parents[2]
FAB = Path(sys.executable).parent / "fab"

LAB = "-".join(filter(None, ("fleettest", os.environ.get("PYTEST_XDIST_WORKER"))))
"""What everything of the tests' own is called on this computer; tests that run side by side have one name each."""

TINY = f"{LAB}-tiny"
HEAVY = f"{LAB}-heavy"
HEAVY_SIZE = 40_000_000

DOCKERFILE = """\
ARG RUN_BASE=debian:bookworm-slim
FROM ${RUN_BASE} AS base
FROM scratch
COPY --from=base /lib/ld-linux-aarch64.so.1 /lib/aarch64-linux-gnu/libc.so.6 /lib/
COPY --from=base /bin/cat /bin/env /bin/false /bin/sh /bin/sleep /bin/true /bin/
COPY payload /
CMD ["sh", "-c", "while echo tick $COLOUR; do sleep 1; done"]
"""
"""A 2 MB image, and whatever its payload weighs. Its container is healthy within a second, under emulation too."""


QUICK = "interval: 5s, retries: 1, start_period: 20s, start_interval: 100ms"
ANYWHERE = "interval: 500ms, retries: 1, start_period: 20s"
"""The start interval came with Docker 25, and older engines refuse to run what has one."""


def service(image: str = TINY, *, more: str = "", check: str = "true", times: str = QUICK) -> str:
    """One service of a Compose file, quick to become healthy and quick to stop; ``more`` are lines of its own."""
    return f"""
    image: {image}
    environment: [COLOUR, FLEET_ROBOT]
    healthcheck: {{test: [CMD-SHELL, "{check}"], {times}}}
    restart: unless-stopped
    stop_signal: SIGKILL
    {more}
"""


def built(folder: str) -> str:
    """How an image with `DOCKERFILE` is built from a folder beside the Compose file's."""
    base = "${FLEET_DEBIAN_BOOKWORM:-debian:bookworm-slim}"
    return f"build: {{context: ../{folder}, args: {{RUN_BASE: '{base}'}}}}"


def stack(**services: str) -> str:
    """A Compose file; each service as `service` writes it."""
    return "name: tiny\nservices:\n" + "".join(f"  {name}:{text}" for name, text in services.items())


def eventually(look: Callable[[], T], *, within: float = 20.0) -> T:
    """What ``look`` gives once that is true, or the last it gave when the time (seconds) is over."""
    deadline = time.monotonic() + within
    while not (found := look()) and time.monotonic() < deadline:
        time.sleep(0.05)
    return found


def on_each(pis: tuple[Pi, ...], work: Callable[[Pi], T]) -> list[T]:
    """The same on every Pi, at once."""
    with ThreadPoolExecutor(len(pis)) as pool:
        return list(pool.map(work, pis))


def forget(*images: str) -> None:
    """Remove the desktop's images of these names, whatever their tags. By name: another's may be the very same image."""
    references = (part for name in images for part in ("--filter", f"reference={name}"))
    listing = ("docker", "image", "ls", "--format", "{{.Repository}}:{{.Tag}}", *references)
    found = subprocess.run(listing, capture_output=True, text=True, check=True).stdout.split()
    if found:
        subprocess.run(("docker", "image", "rm", "--force", *found), capture_output=True, check=True)


def wipe(pi: Pi) -> None:
    """As after `fab provision`: no container, no release, no heavy image. The tiny image stays, it is on its way only once."""
    script = (
        "docker ps --all --quiet | xargs --no-run-if-empty docker rm --force"
        f"; docker image ls --quiet {HEAVY} | sort -u | xargs --no-run-if-empty docker image rm --force"
        "; rm -rf ~pi/.fleet"
    )
    pi.exec("sh", "-c", script)


def running(pi: Pi) -> dict[str, tuple[str, str]]:
    """Each running service: its container, and the release that this is of."""
    form = '{{.Label "com.docker.compose.service"}} {{.ID}} {{.Label "fleet.release"}}'
    lines = pi.exec("docker", "ps", "--format", form).splitlines()
    return {name: (container, release) for name, container, release in (line.split() for line in lines)}


def current(pi: Pi) -> str:
    """The release that is current of the one stack there is, "" if nothing is there."""
    return pi.exec("sh", "-c", "readlink ~pi/.fleet/stacks/*/current || true").rpartition("/")[2]


def processes(pi: Pi, pattern: str) -> list[str]:
    """The command lines on a Pi that match; not the one that looks."""
    argv = ("docker", "exec", pi.container, "pgrep", "--full", "--list-full", pattern)
    return subprocess.run(argv, capture_output=True, text=True, check=False).stdout.splitlines()


def spool(pi: Pi) -> str:
    """What lies in the spool, but for its lock."""
    return pi.exec("sh", "-c", "ls ~pi/.fleet/spool | grep -v lock || true")


def spooled(pi: Pi) -> int:
    """Bytes that have arrived of what is not loaded yet."""
    script = "cat ~pi/.fleet/spool/[0-9a-f]* 2>/dev/null | wc -c"
    return int(pi.exec("sh", "-c", script))


def tags(pi: Pi) -> list[str]:
    """Every name by which a release may know an image, and every one that says it is still on its way."""
    names = pi.exec("docker", "image", "ls", "--format", "{{.Repository}}:{{.Tag}}").splitlines()
    return [name for name in names if ":fleet-" in name or INCOMING in name]


def prove(pi: Pi, image: str = "") -> None:
    """Every layer of an image is bit for bit what its configuration says, as Docker itself gives it back.

    Of the one that runs where none is named.
    """
    image = image or pi.exec("docker", "inspect", "--format", "{{.Config.Image}}", running(pi)["tick"][0])
    saved = subprocess.run(
        ("docker", "exec", pi.container, "docker", "save", image), capture_output=True, check=True
    )
    with tarfile.open(fileobj=io.BytesIO(saved.stdout)) as archive:
        files = {member.name: member for member in archive if member.isfile()}

        def read(name: str) -> bytes:
            content = archive.extractfile(files[name])
            assert content
            return content.read()

        (manifest,) = json.loads(read("manifest.json"))
        layers = [read(name) for name in manifest["Layers"]]
        digests = [f"sha256:{hashlib.sha256(codec.inflater(data)(data)).hexdigest()}" for data in layers]
        assert digests == json.loads(read(manifest["Config"]))["rootfs"]["diff_ids"], (pi.name, image)


def environment(pi: Pi, service: str = "tick") -> dict[str, str]:
    """What the container of a service really has, as its own process has it."""
    inner = ("docker", "exec", running(pi)[service][0], "cat", "/proc/1/environ")
    said = subprocess.run(("docker", "exec", pi.container, *inner), capture_output=True, check=True).stdout
    return dict(pair.partition("=")[::2] for pair in said.decode().split("\0") if pair)


@dataclass(frozen=True, kw_only=True)
class Said:
    """What `fab` did: its exit code and what it wrote."""

    code: int
    out: str
    err: str

    @property
    def all(self) -> str:
        """Both, for messages that may be in either."""
        return f"{self.out}\n{self.err}"

    @property
    def json(self) -> Any:  # noqa: ANN401  it is JSON
        return json.loads(self.out)

    @property
    def status(self) -> dict[str, str]:
        """What became of each robot, where `fab` was asked for ``--json``."""
        return {outcome["robot"]: outcome["status"] for outcome in self.json}


class Running:
    """A `fab` that runs, and what it has written so far."""

    def __init__(self, argv: tuple[str, ...], *, cwd: Path, env: dict[str, str]) -> None:
        # A test run that was started in the background ignores Ctrl-C, and so would what it starts.
        self._process = subprocess.Popen(
            ("env", "--default-signal=INT", *argv),
            cwd=cwd,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._texts: dict[str, str] = {"out": "", "err": ""}
        self._readers = [
            threading.Thread(target=self._read, args=(name, pipe), daemon=True)
            for name, pipe in (("out", self._process.stdout), ("err", self._process.stderr))
        ]
        for reader in self._readers:
            reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()

    def _read(self, name: str, pipe: Any) -> None:  # noqa: ANN401  a text pipe
        with pipe:
            for line in pipe:
                self._texts[name] += line

    def wrote(self, text: str) -> bool:
        """Whether `fab` has written this, wherever."""
        return any(text in said for said in self._texts.values())

    def await_text(self, text: str, *, within: float = 60.0) -> None:
        """Wait until `fab` has written this, wherever."""

        eventually(lambda: self.wrote(text) or self._process.poll() is not None, within=within)
        assert self.wrote(text), f"no {text!r} in {self._texts}"

    def ctrl_c(self) -> None:
        """As Ctrl-C does."""
        self._process.send_signal(2)

    def end(self, *, within: float = 60.0) -> Said:
        """Wait for its end."""
        try:
            code = self._process.wait(within)
        except subprocess.TimeoutExpired:
            self._process.kill()
            raise AssertionError(f"fab did not end in {within:g} s: {self._texts}") from None
        for reader in self._readers:
            reader.join(10)
        return Said(code=code, out=self._texts["out"], err=self._texts["err"])


@dataclass(frozen=True, kw_only=True)
class Project:
    """A folder with a fabfile, an inventory that includes the lab's, and a stack."""

    directory: Path
    lab: Lab

    @classmethod
    def made(cls, directory: Path, lab: Lab) -> Project:
        """A new one, whose stack is one tiny service ``tick``."""
        project = cls(directory=directory, lab=lab)
        for name in ("fabfile.py", "fabric.yaml"):
            project.write(name, (ROOT / name).read_text())
        project.stack(tick=service())
        project.inventory()
        return project

    @classmethod
    def copied(cls, directory: Path, lab: Lab, *, image: str) -> Project:
        """This repository as a person clones it, its inventory with the lab's robots, its image under another name."""
        listing = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        names = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
            "\0"
        )
        for name in filter(None, names):
            if (ROOT / name).is_file():
                (directory / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, directory / name)
        project = cls(directory=directory, lab=lab)
        project.edit("inventory.yaml", "path: .lab/inventory.yaml", f"path: {lab.inventory}")
        project.edit("docker/compose.yaml", "image: talker", f"image: {image}")
        return project

    def edit(self, name: str, old: str, new: str) -> None:
        """Change one place in a file of the project."""
        path = self.directory / name
        text = path.read_text()
        assert text.count(old) == 1, (name, old)
        path.write_text(text.replace(old, new))

    def write(self, name: str, text: str) -> Path:
        """Write a file of the project."""
        path = self.directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    def stack(self, **services: str) -> None:
        """What the robots run."""
        self.write("docker/compose.yaml", stack(**services))

    def inventory(self, *, also: Path | None = None, **groups: dict[str, object]) -> None:
        """The lab's robots, and those of another inventory; a group may give some of them values."""
        said = {
            "stack": "docker/compose.yaml",
            "include": [{"path": str(path)} for path in (self.lab.inventory, also) if path],
            "groups": {"fleet": ["*"], **groups},
        }
        self.write("inventory.yaml", json.dumps(said, indent=1, ensure_ascii=False))

    def colour(self, value: str) -> None:
        """Another value of one variable: another release for every robot, and no other image."""
        self.inventory(everyone={"robots": ["*"], "environment": {"COLOUR": value}})

    def start(self, *arguments: str, cwd: Path | None = None, env: dict[str, str] | None = None) -> Running:
        """Start `fab`, in the project or a folder of it, with a person's environment and ``env``."""
        person = {
            name: value
            for name, value in os.environ.items()
            if name not in ("FLEET_INVENTORY", "SSH_AUTH_SOCK")
        }
        person |= {"PYTHONPATH": str(ROOT), **(env or {})}
        return Running((str(FAB), *arguments), cwd=cwd or self.directory, env=person)

    def fab(self, *arguments: str, within: float = 120.0, env: dict[str, str] | None = None) -> Said:
        """Run `fab` to its end, whatever that is. A traceback is never what a person should see."""
        with self.start(*arguments, env=env) as fab:
            said = fab.end(within=within)
        assert "Traceback" not in said.all, said.all
        return said

    def well(self, *arguments: str, within: float = 120.0) -> Said:
        """Run `fab`, which must succeed."""
        said = self.fab(*arguments, within=within)
        assert said.code == 0, said.all
        return said


@contextmanager
def cut(pi: Pi, *, after: int = 0) -> Iterator[Callable[[], bool]]:
    """The link to a Pi, cut after so many more bytes to its sshd; whole again at the end. Tells whether it is cut yet.

    Nothing is refused, as when a robot leaves the Wi-Fi: what is sent is never answered.
    """
    ssh = ("INPUT", "--protocol", "tcp", "--dport", "22")
    pi.exec("iptables", "--append", *ssh, "--match", "quota", "--quota", str(after), "--jump", "ACCEPT")
    pi.exec("iptables", "--append", *ssh, "--jump", "DROP")

    def happened() -> bool:
        counters = pi.exec("iptables", "--list-rules", "INPUT", "--verbose").splitlines()[-1]
        return " -c 0 0 " not in counters

    try:
        yield happened
    finally:
        pi.exec("iptables", "--flush", "INPUT")
