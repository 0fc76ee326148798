"""What does a build say? BuildKit's plain progress, line by line, as steps.

The same lines come from ``docker build`` with BuildKit from 18.09 on and from buildx: ``#5 [2/3] RUN make`` begins a
step, ``#5 CACHED``, ``#5 DONE 1.2s``, ``#5 ERROR: ...`` end it, and ``#5 0.4 text`` is its output. Lines of steps that
run side by side are mixed.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass, field

from fleet import terminal

TAIL = 12
"""Lines of a failing step that are shown: a compiler's last words, not its whole output."""

_LINE = re.compile(r"#(\d+) (.*)")
_OUTPUT = re.compile(r"\d+\.\d+ ?(.*)")
# What BuildKit 0.8 and 0.13 say of a program that failed: the whole command again, which the step's title has.
_FAILED_PROGRAM = re.compile(r"(executor failed running \[|process \").*exit code: \d+")
_OURS = re.compile(r"\[(?!internal\]|auth\])[^\]]+\] ")

# Words of BuildKit and of programs in a build, and what cures them.
_CURES = (
    (
        "exec format error",
        "this computer cannot run programs of that platform: install the packages qemu-user-static and binfmt-support",
    ),
    ("no space left on device", "free some disk: docker system df shows what Docker uses"),
    ("no such host", "see whether this computer reaches the registry or the server of that name"),
    ("pull access denied", "correct the image's name, or log in: docker login"),
    (
        "failed to compute cache key",
        "correct the name of the file or folder in the Dockerfile, or let .dockerignore admit it",
    ),
    ("failed to resolve source metadata", "correct the image's name, or see whether its registry answers"),
)


@dataclass(kw_only=True)
class Step:
    """One step of a Dockerfile: ``title`` as BuildKit names it, such as ``[build 2/3] RUN make``."""

    title: str
    cached: bool = False
    done: bool = False
    failed: bool = False
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=TAIL))


@dataclass(kw_only=True)
class BuildLog:
    """The steps of one build so far. Feed it with the lines that the build prints."""

    steps: dict[int, Step] = field(default_factory=dict)
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=TAIL))

    def feed(self, line: str) -> Step | None:
        """Take one line; return the step that works now, if the line tells so. A step from the cache does not work."""
        text = terminal.plain(line).strip()
        if not (match := _LINE.fullmatch(text)):
            if text:
                self.tail.append(text)
            return None
        number, said = int(match[1]), match[2]
        if _OURS.match(said) and number not in self.steps:
            self.steps[number] = Step(title=said)
            return None
        return self._about(number, said)

    def _about(self, number: int, said: str) -> Step | None:
        """Take what a step says. Steps that are BuildKit's own only count if they fail."""
        step = self.steps.get(number)
        if said.startswith("ERROR"):
            step = self.steps.setdefault(number, Step(title=""))
            step.failed = True
            step.tail.append(said.removeprefix("ERROR").removeprefix(":").strip())
        if step is None or said.startswith("ERROR"):
            return None
        if said == "CACHED":
            step.cached = step.done = True
        elif said.startswith("DONE"):
            step.done = True
        elif (output := _OUTPUT.fullmatch(said)) and not step.failed:  # BuildKit repeats them after the end
            step.tail.append(output[1])
            return step
        return None

    def summary(self) -> str:
        """Return how many steps there were and how many of them were cached, such as ``5 steps, 3 cached``."""
        titled = [step for step in self.steps.values() if step.title]
        cached = sum(step.cached for step in titled)
        count = f"{len(titled)} step{'s' * (len(titled) != 1)}"
        return f"{count}, all cached" if titled and cached == len(titled) else f"{count}, {cached} cached"

    def failure(self) -> tuple[str, tuple[str, ...], str]:
        """Return the title of the step that failed, its last lines, and a cure; each is empty if it is not known."""
        failed = next((step for step in self.steps.values() if step.failed), None)
        title = failed.title if failed else ""
        lines = [line for line in (failed.tail if failed else self.tail) if line.strip()]
        own = [line for line in lines if not _FAILED_PROGRAM.fullmatch(line)]
        lines = own or lines
        words = "\n".join((*lines, *self.tail)).lower()
        return title, tuple(lines), next((cure for sign, cure in _CURES if sign in words), "")
