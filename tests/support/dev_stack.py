"""A robot with one stack on this computer's Docker, as `fab ship` leaves it: what the tests of `fab dev` bring files into."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from fleet import onboard

if TYPE_CHECKING:
    from collections.abc import Mapping

NODE = "trap 'exit 0' TERM; cat /app/node; . /app/node; while :; do sleep 0.1; done"
"""What the container does: it reads its program, as a node of ROS does, and stays."""


@dataclass(frozen=True)
class DevStack:
    """A home directory with one stack in it, whose release ``one`` runs, and its container."""

    home: Path
    image: str
    name: str = field(default_factory=lambda: f"fleet-test-{uuid.uuid4().hex[:12]}")

    @property
    def folder(self) -> Path:
        return self.home / ".fleet/stacks" / self.name

    @property
    def dev(self) -> Path:
        return self.folder / "dev"

    @property
    def environment(self) -> dict[str, str]:
        return {"PATH": f"{self.home.parent / 'bin'}:{os.environ['PATH']}", "HOME": str(self.home)}

    def start(self) -> None:
        """Write the release, and start it."""
        compose = Path(sys.executable).with_name("docker-compose")
        wrapper = self.home.parent / "bin/docker"
        wrapper.parent.mkdir(parents=True, exist_ok=True)
        wrapper.write_text(
            f'#!/bin/sh\nif [ "$1" = compose ]; then shift; exec {compose} "$@"; fi\n'
            f'exec {shutil.which("docker")} "$@"\n'
        )
        wrapper.chmod(0o755)
        release = self.folder / "releases/one"
        release.mkdir(parents=True)
        node = {
            "image": self.image,
            "command": ["sh", "-c", NODE.replace("$", "$$")],
            "restart": "always",
            "stop_grace_period": "1s",
            "network_mode": "none",
            "labels": {"fleet.release": "one", "fleet.stack": self.name},
        }
        (release / "compose.yaml").write_text(json.dumps({"name": self.name, "services": {"node": node}}))
        (release / "services").write_text("node=always\n")
        assert self.swap("ship").returncode == 0

    def swap(self, verb: str, **environment: str) -> subprocess.CompletedProcess[str]:
        script = ("sh", "-c", onboard.text("swap.sh"), "swap")
        argv = (*script, verb, self.name, "one", "?", "tim@desktop", "10", "1", "robot")
        return self.run(argv, environment=environment)

    def run(
        self, argv: tuple[str, ...], *, data: bytes = b"", environment: Mapping[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Run a command as a robot does: in its home."""
        done = subprocess.run(
            argv,
            env={**self.environment, **(environment or {})},
            cwd=self.home,
            input=data,
            capture_output=True,
            timeout=60,
            check=False,
        )
        return subprocess.CompletedProcess(argv, done.returncode, done.stdout.decode(), done.stderr.decode())

    @property
    def ids(self) -> list[str]:
        label = f"label=com.docker.compose.project={self.name}"
        listing = ("docker", "ps", "--all", "--quiet", "--no-trunc", "--filter", label)
        return subprocess.run(listing, check=True, capture_output=True, text=True).stdout.split()

    def read(self, path: str) -> str | None:
        """The text of a file in the container, None if one of both is not there."""
        container = next(iter(self.ids), "none")
        copied = subprocess.run(
            ("docker", "cp", f"{container}:{path}", "-"), capture_output=True, check=False
        )
        if copied.returncode:
            return None
        with tarfile.open(fileobj=io.BytesIO(copied.stdout)) as archive:
            # Docker ends the archive with nothing in it when the file goes between its look and its copy.
            member = archive.next()
            content = archive.extractfile(member) if member else None
            return content.read().decode() if content else None

    def logs(self) -> str:
        """What the container says, or what Docker says of one that is not there."""
        return subprocess.run(
            ("docker", "logs", next(iter(self.ids), "none")),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        ).stdout

    def clear(self) -> None:
        if self.ids:
            subprocess.run(
                ("docker", "rm", "--force", "--volumes", *self.ids), check=True, capture_output=True
            )


class Holding:
    """`dev_hold.sh` while it runs, and what it has printed."""

    def __init__(self, robot: DevStack, argv: tuple[str, ...]) -> None:
        self._out = robot.home.parent / f"hold-{uuid.uuid4().hex}"
        with self._out.open("wb") as out:
            self.process = subprocess.Popen(
                argv,
                env=robot.environment,
                cwd=robot.home,
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=subprocess.STDOUT,
            )

    @property
    def text(self) -> str:
        return self._out.read_text()

    def await_text(self, text: str, *, within: float = 30.0) -> str:
        end = time.monotonic() + within
        while text not in self.text and time.monotonic() < end:
            time.sleep(0.05)
        assert text in self.text, self.text
        return self.text

    def end(self) -> int:
        """Close its input, as a lost connection does."""
        assert self.process.stdin
        self.process.stdin.close()
        return self.process.wait(20)

    def end_by_itself(self) -> tuple[int, str]:
        """Wait for its end: its exit code and its output."""
        code = self.process.wait(30)
        self.end()
        return code, self.text
