"""What does a power cut do to a card? Whatever was not synced is gone.

A file system of its own (ext4 in a file, on a loop device) holds what a virtual Pi writes: its login's home, and all of
its Docker. It is shut down without a flush of its log, as xfstests do it; then it is mounted again, and replays the log.
Needs root.
"""

from __future__ import annotations

import fcntl
import os
import struct
import subprocess
import time
from typing import TYPE_CHECKING

from fleet.lab import lifecycle
from fleet.lab.virtual_pi import run_command

if TYPE_CHECKING:
    from pathlib import Path

    from tests.lab.conftest import Pi

SIZE = "4G"
_SHUTDOWN, _WITHOUT_FLUSH = (
    0x8004587D,
    2,
)  # EXT4_IOC_SHUTDOWN, EXT4_GOING_FLAGS_NOLOGFLUSH: linux/fs/ext4/ext4.h


class SdCard:
    """A card in a virtual Pi. ``folder`` is where its file and its mount are."""

    def __init__(self, folder: Path) -> None:
        self._file, self._mount = folder / "card.img", folder / "card"
        self._mount.mkdir()
        run("truncate", "--size", SIZE, str(self._file))
        run("mkfs.ext4", "-q", str(self._file))
        self._insert()

    def put_into(self, pi: Pi) -> None:
        """Make the Pi anew, with its home and its Docker on the card."""
        (virtual,) = (
            one
            for one in lifecycle.list_(name=pi.container.removesuffix(f"-{pi.name}"))
            if one.name == pi.name
        )
        image = run("docker", "inspect", "--format", "{{.Config.Image}}", pi.container)
        run("docker", "cp", "--archive", f"{pi.container}:/home/pi", str(self._mount / "home"))
        (self._mount / "docker").mkdir()
        run("docker", "rm", "--force", pi.container)
        argv = run_command(
            virtual, image=image, network=f"fleet-{virtual.lab}", labels=(f"fleet.lab={virtual.lab}",)
        )
        places = {f"{virtual.volume}:/var/lib/docker": f"{self._mount}/docker:/var/lib/docker"}
        argv = tuple(places.get(word, word) for word in argv)
        run("docker", *argv[:1], "--volume", f"{self._mount}/home:/home/pi", *argv[1:])
        run("docker", "exec", pi.container, "chown", "--recursive", "pi:pi", "/home/pi")

    def cut_power(self, pi: Pi) -> None:
        """Lose what was not synced, and everything that runs; then give the power back."""
        handle = os.open(self._mount, os.O_RDONLY)
        try:
            fcntl.ioctl(handle, _SHUTDOWN, struct.pack("I", _WITHOUT_FLUSH))
        finally:
            os.close(handle)
        run("docker", "kill", pi.container)
        deadline = time.monotonic() + 30
        while True:
            self.remove()
            self._insert()
            if self._works():
                break
            # Somebody else's namespace still has the mount, and so the file system that was shut down.
            assert time.monotonic() < deadline, "the card stays shut down"
            time.sleep(0.2)
        run("docker", "start", pi.container)

    def _works(self) -> bool:
        try:
            (self._mount / "works").write_text("")
        except OSError:
            return False
        return True

    def remove(self) -> None:
        """Unmount it; whoever looks at it just now has time to end."""
        deadline = time.monotonic() + 20
        while subprocess.run(("umount", self._mount), capture_output=True, check=False).returncode:
            assert time.monotonic() < deadline, run("fuser", "--verbose", "--mount", str(self._mount))
            time.sleep(0.1)

    def _insert(self) -> None:
        run("mount", "-o", "loop", str(self._file), str(self._mount))


def run(*argv: str) -> str:
    """What a command prints, which must succeed."""
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (argv, done.stderr)
    return done.stdout.strip()
