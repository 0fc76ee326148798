"""How is a build run? Quietly: its steps are counted, its output is kept, and shown if it fails."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol

from fleet.errors import DesktopError
from fleet.images import debian_base
from fleet.images.build_log import BuildLog
from fleet.images.docker_cli import docker_or_none
from fleet.images.image import platform
from fleet.units import human_seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fleet.images.build import Command


MEMORY_OF_A_BUILD = 2 * 10**9
"""Bytes that a build may need: a compiler or two, emulated."""


@dataclass(frozen=True, kw_only=True)
class Built:
    """How a command ended: what it did in words, its seconds, and where its output is."""

    summary: str
    seconds: float
    log: Path

    def __str__(self) -> str:
        took = f"{self.seconds:.1f} s" if self.seconds < 10 else human_seconds(self.seconds)
        return f"{self.summary}, {took}"


def logs() -> Path:
    """Return the folder that keeps the output of each image's last build."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet" / "builds"


class Watcher(Protocol):
    """Hears how builds go; called from many threads. ``name`` is the image's."""

    def note(self, name: str, text: str) -> None:
        """Something that is not a step."""

    def step(self, name: str, title: str) -> None:
        """The title of a step that works: one that is not cached."""

    def built(self, name: str, built: Built) -> None:
        """A command ended well."""


def run_all(
    commands: Sequence[Command], *, watcher: Watcher, memory: int, folder: Path | None = None
) -> None:
    """Run commands, those for different images side by side as far as ``memory`` (bytes that are free) allows.

    Raises:
        DesktopError: the first one that failed; those that had begun are ended first.

    """
    for base in dict.fromkeys(base for command in commands for base in command.bases):
        debian_base.ensure(base.suite, base.platform, say=partial(watcher.note, base.tag))
    turns: dict[str, list[Command]] = {}
    for command in commands:
        turns.setdefault(command.turn or command.reference, []).append(command)
    failed = threading.Event()

    def make(turn: Sequence[Command]) -> None:
        named = set[str]()
        for command in turn:
            if failed.is_set():
                return
            if command.reference in named:
                continue  # it has its name already
            try:
                there = _run_or_use(command, watcher=watcher, folder=folder)
            except BaseException:
                failed.set()
                raise
            if there == command.reference:
                named.add(there)

    with ThreadPoolExecutor(at_once(len(turns), memory=memory)) as pool:
        for work in [pool.submit(make, turn) for turn in turns.values()]:
            work.result()


def _run_or_use(command: Command, *, watcher: Watcher, folder: Path | None) -> str:
    """Run a command. If it was to pull an image, and one that is here does instead, return that one's name."""
    there = here(command) if command.only_missing else None
    if there:
        return there.name
    try:
        built = run(command, on_step=partial(watcher.step, command.reference), folder=folder)
    except DesktopError as problem:
        there = here(command)
        if not there:
            raise
        why = " ".join(problem.what.split())
        watcher.note(command.reference, f"{why}; the image of {there.created} that is here is used")
        return there.name
    watcher.built(command.reference, built)
    return ""


def at_once(images: int, *, memory: int) -> int:
    """Return how many builds run side by side: one for each processor, and for each 2 GB of free memory."""
    return max(1, min(images, os.cpu_count() or 1, memory // MEMORY_OF_A_BUILD))


def free_memory(meminfo: Path = Path("/proc/meminfo")) -> int:
    """Return the memory that is free on this computer, in bytes; 0 if it is not known."""
    try:
        found = re.search(r"^MemAvailable: +(\d+) kB$", meminfo.read_text(), re.MULTILINE)
    except OSError:
        return 0
    return int(found[1]) * 1024 if found else 0


def run(command: Command, *, on_step: Callable[[str], None], folder: Path | None = None) -> Built:
    """Run one command; its bases are there. ``on_step`` hears the title of each step that is not cached.

    Raises:
        DesktopError: it failed; with the failing step's last lines and the place of the whole output.

    """
    began, said = time.monotonic(), BuildLog()
    log = (folder or logs()) / f"{re.sub(r'[^A-Za-z0-9_.-]+', '_', command.reference)}.log"
    on_step(command.title.replace(f" {command.reference}", ""))
    with _opened(log) as kept, _fed(command.feed) as feed:
        code = _watched(command, feed=feed, kept=kept, said=said, on_step=on_step)
    if code:
        raise _failure(command, said, code=code, log=log)
    what = said.summary() if said.steps else command.title.partition(" ")[0]
    return Built(summary=what, seconds=time.monotonic() - began, log=log)


def _watched(
    command: Command, *, feed: IO[bytes], kept: IO[bytes], said: BuildLog, on_step: Callable[[str], None]
) -> int:
    """Run the command to its end; return its exit code."""
    shown = ""
    # Not a terminal's moving lines, whatever the person has set.
    environment = os.environ | {"BUILDKIT_PROGRESS": "plain"}
    try:
        with subprocess.Popen(
            command.argv, stdin=feed, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment
        ) as process:
            assert process.stdout is not None  # noqa: S101 - for the type checker: PIPE was asked for
            for line in process.stdout:
                kept.write(line)
                step = said.feed(line.decode(errors="replace"))
                if step and step.title != shown:
                    shown = step.title
                    on_step(shown)
    except FileNotFoundError:
        raise DesktopError(
            f"{command.argv[0]} is not installed on this computer",
            cure="install Docker Engine: https://docs.docker.com/engine/install",
        ) from None
    return process.returncode


def _opened(log: Path) -> IO[bytes]:
    """Open the log for writing; raises `DesktopError`."""
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        return log.open("wb")
    except OSError as problem:
        raise DesktopError(f"{log} cannot be written: {problem.strerror}") from None


def _fed(text: str) -> IO[bytes]:
    """Return the command's standard input: a file, because a pipe would have to be fed beside reading."""
    feed = tempfile.TemporaryFile()  # noqa: SIM115  the caller closes it
    feed.write(text.encode())
    feed.seek(0)
    return feed


def _failure(command: Command, said: BuildLog, *, code: int, log: Path) -> DesktopError:
    title, lines, cure = said.failure()
    where = f" in {title}" if title else f" with code {code}"
    shown = "".join(f"\n  | {line}" for line in lines)
    whole = f"the whole output is in {log}"
    return DesktopError(f"{command.title} failed{where}{shown}", cure=f"{cure}; {whole}" if cure else whole)


@dataclass(frozen=True, kw_only=True)
class Here:
    """An image that Docker has: one of its names, and the day on which it was made."""

    name: str
    created: str


def here(command: Command) -> Here | None:
    """Return the image that a pull asks for, if one for its platform is here: by its own name, or by the one of an earlier pull."""
    form = "{{.Os}} {{.Architecture}} {{.Variant}} {{.Created}}"
    for name in (command.pulls, command.reference):
        answer = docker_or_none("image", "inspect", "--format", form, name) if command.pulls else None
        os_, architecture, variant, created = (answer or "   ").split(" ")
        if answer and platform(os=os_, architecture=architecture, variant=variant) == command.platform:
            return Here(name=name, created=created[:10])
    return None
