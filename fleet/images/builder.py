"""How is a build run? Quietly: its steps are counted, its output is kept, and shown if it fails."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fleet.errors import DesktopError
from fleet.images import debian_base
from fleet.images.build_log import BuildLog
from fleet.units import human_seconds

if TYPE_CHECKING:
    from collections.abc import Callable

    from fleet.images.build import Command


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


def run(
    command: Command,
    *,
    on_note: Callable[[str], None],
    on_step: Callable[[str], None],
    folder: Path | None = None,
) -> Built:
    """Run one command, its bases first. ``on_step`` hears the title of each step that is not cached.

    Raises:
        DesktopError: it failed; with the failing step's last lines and the place of the whole output.

    """
    for base in command.bases:
        debian_base.ensure(base.suite, base.platform, say=on_note)
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
