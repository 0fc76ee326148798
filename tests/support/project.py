"""A person's project in a temporary folder: an inventory of real SSH servers, a stack, and `fab` as it is typed."""

from __future__ import annotations

import contextlib
import getpass
import io
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet import cli
from tests.support.homes import Home, start
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from tests.support.sshd import Sshds

ROOT = Path(__file__).parents[2]
FAB = Path(sys.executable).parent / "fab"


@dataclass(frozen=True, kw_only=True)
class Done:
    """How a line on the terminal ended."""

    code: int
    out: str
    err: str


@dataclass(frozen=True, kw_only=True)
class Project:
    """The folder, and the robots of its inventory; ``away`` is in it too, and nobody listens there."""

    folder: Path
    robots: dict[str, Home]

    @property
    def environment(self) -> dict[str, str]:
        """What the person's shell exports, and nothing of this test run's."""
        kept = {name: os.environ[name] for name in ("PATH", "DOCKER_HOST") if name in os.environ}
        return {**kept, "HOME": str(self.folder), "PYTHONPATH": str(ROOT), "LANG": "C.UTF-8"}

    def fab(self, *words: str, folder: str = "", **environment: str) -> Done:
        """Type ``fab`` and these words, with the project or a folder in it as the current directory."""
        done = subprocess.run(
            (str(FAB), *words),
            cwd=self.folder / folder,
            env={**self.environment, **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        return Done(code=done.returncode, out=done.stdout, err=done.stderr)

    def fleet(self, *words: str) -> Done:
        """Type ``fleet`` and these words: the same verbs, here run in this process, which takes a tenth of the time."""
        out, err, code = io.StringIO(), io.StringIO(), 0
        with pytest.MonkeyPatch.context() as person:
            person.chdir(self.folder)
            person.delenv("FLEET_INVENTORY", raising=False)
            person.setattr("sys.argv", ["fleet", *words])
            try:
                with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                    cli.main()
            except SystemExit as end:
                code = int(end.code or 0)
        return Done(code=code, out=out.getvalue(), err=err.getvalue())


def make(sshds: Sshds, *names: str) -> Project:
    """A project with these robots, their host keys recorded, and ``away``."""
    folder = sshds.folder
    robots = {name: start(sshds, name) for name in names}
    lines = [f"  {name}: {{address: 127.0.0.1, port: {home.server.port}}}" for name, home in robots.items()]
    text = (
        "stack: stack/compose.yaml\n"
        f"defaults: {{user: {getpass.getuser()}, identity_file: id}}\n"
        "groups: {fleet: [pi*]}\n"
        "robots:\n" + "\n".join((*lines, f"  away: {{address: 127.0.0.1, port: {free_port()}}}", ""))
    )
    (folder / "inventory.yaml").write_text(text)
    (folder / "stack").mkdir()
    (folder / "stack/compose.yaml").write_text(
        "services:\n  talker:\n    image: fleet-test-none\n    build: .\n"
    )
    (folder / "stack/Dockerfile").write_text("FROM scratch\n")
    for name in ("fabfile.py", "fabric.yaml"):
        shutil.copy(ROOT / name, folder)
    return Project(folder=folder, robots=robots)
