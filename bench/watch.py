"""What can be seen of a run from outside, while it goes on?"""

from __future__ import annotations

import contextlib
import os
import re
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.images.docker_cli import docker

if TYPE_CHECKING:
    from fleet.lab.virtual_pi import VirtualPi
    from tests.support.wifi import Wifi

_LOOKS_EVERY = 0.25
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(kw_only=True)
class _Seen:
    at: float
    payload: int


@dataclass
class Watch:
    """Looks at a run again and again, from another thread: memory on both sides, bytes as they flow, and an outage."""

    link: Wifi
    pi: VirtualPi
    outage: tuple[int, float] | None = None
    session: int = 0
    desk_peak: int = 0
    robot_peak: int = 0
    happened: bool = False
    _seen: list[_Seen] = field(default_factory=list)
    _over: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> None:
        self._memory = _memory_file(self.pi)
        self._before = _anonymous(self._memory)
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    @property
    def speed(self) -> float:
        """Payload bytes a second, over those times in which at least a twentieth of the fastest flowed."""
        steps = [
            (b.payload - a.payload, b.at - a.at) for a, b in zip(self._seen, self._seen[4:], strict=False)
        ]
        fastest = max((size / took for size, took in steps), default=0)
        flowed = [(size, took) for size, took in steps if size / took > fastest / 20]
        return sum(size for size, _ in flowed) / (sum(took for _, took in flowed) or 1)

    def _look(self) -> None:
        while not self._over.wait(_LOOKS_EVERY):
            name = self.pi.name
            self._seen.append(_Seen(at=time.monotonic(), payload=self.link.traffic(name).payload))
            self.robot_peak = max(self.robot_peak, _anonymous(self._memory) - self._before)
            self.desk_peak = max(self.desk_peak, _resident(self.session))
            sent = self._seen[-1].payload - self._seen[0].payload
            if self.outage and not self.happened and sent > self.outage[0]:
                self.link.cut(self.outage[1], name)
                self.happened = True


def written(pi: VirtualPi) -> int:
    """Bytes that a robot's processes have handed to its disk. Those that ended count with who waited for them."""
    look = "cat /proc/[0-9]*/io 2> /dev/null; true"
    said = docker("exec", pi.container, "sh", "-c", look)
    return sum(int(found) for found in re.findall(r"^write_bytes: (\d+)", said, re.MULTILINE))


def _memory_file(pi: VirtualPi) -> Path | None:
    """Where the kernel says how much memory a robot's processes have: control groups of either version."""
    name = docker("inspect", "--format", "{{.Id}}", pi.container)
    groups = (
        "memory/docker/{}",
        "memory/system.slice/docker-{}.scope",
        "docker/{}",
        "system.slice/docker-{}.scope",
    )
    paths = (Path("/sys/fs/cgroup") / group.format(name) / "memory.stat" for group in groups)
    return next((path for path in paths if path.exists()), None)


def _anonymous(stat: Path | None) -> int:
    """Memory without what only keeps files at hand."""
    found = re.search(r"^(?:total_rss|anon) (\d+)", stat.read_text(), re.MULTILINE) if stat else None
    return int(found[1]) if found else 0


def _resident(session: int) -> int:
    """What all processes of a session have in memory."""
    pages = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            words = path.read_text().rpartition(")")[2].split()
            pages += int(words[21]) if int(words[3]) == session else 0
    return pages * _PAGE
