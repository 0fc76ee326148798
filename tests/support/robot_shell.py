"""Run the scripts of robots on this computer."""

from __future__ import annotations

import os
import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.plan.step import Bytes, Step

if TYPE_CHECKING:
    from pathlib import Path

SHELLS = [shell for shell in ("dash", "bash", "busybox") if shutil.which(shell)]
"""The shells that a robot may have as ``sh``, as far as they are installed here."""

EACH_SHELL = [*SHELLS[:1], *(pytest.param(shell, marks=pytest.mark.desktop) for shell in SHELLS[1:])]
"""The same as values of a test's parameter: `make check` runs the scripts in one shell, `make test` in all."""


def do(step: Step, home: Path) -> subprocess.CompletedProcess[bytes]:
    """Run a step as a robot would: in its home, with its feed as input, or with an input that stays open."""
    environment = {"PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}", "HOME": str(home)}
    data = step.feed.data if isinstance(step.feed, Bytes) else b""
    with subprocess.Popen(
        step.argv,
        cwd=home,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as command:
        if not step.until_closed:
            out, err = command.communicate(data, timeout=20)
            return subprocess.CompletedProcess(step.argv, command.returncode, out, err)
        code = command.wait(timeout=20)
        assert command.stdin
        command.stdin.close()
        return subprocess.CompletedProcess(step.argv, code, b"", b"")
