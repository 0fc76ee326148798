"""What do people ship? An image of 700 MB in five layers, and what becomes of it when one of them changes.

The layers are made the usual way - ``RUN apt-get install``, ``RUN pip install``, ``COPY`` - for the desktop's own
platform, so that nothing is emulated: virtual Pis run that platform as they are, and bytes travel the same on any.
Nothing comes from a registry of images. What was made stays in Docker, under names of its own, until its recipe changes.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import subprocess
import sys
import sysconfig
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.images import debian_base
from fleet.images.docker_cli import buildkit_client, docker, docker_or_none
from fleet.images.emulation import desktop_platform
from fleet.images.image import tagged_for
from fleet.platforms import DEBIAN_ARCHITECTURES

if TYPE_CHECKING:
    from collections.abc import Callable

NAME = "fleetbench-app"
LABEL = "fleet.bench.recipe"
SUITE = "bookworm"

VARIANTS = {
    "v1": "the first ship",
    "v2code": "one line of code changed",
    "v2apt": "one more apt package",
    "v2sec": "apt packages of today's security suite",
    "v2pip": "the pip layer built again, nothing changed",
}

WHEELS = ("numpy==1.26.4", "scipy==1.13.1")
"""Pinned, with all they need: what a new release brings must not change the figures."""

_PACKAGES = "python3-roslaunch python3-rospy python3-pip cmake git"
_MODEL_SIZE, _CODE_SIZE = 28_000_000, 2_000_000
_DATE = 1735689600  # of the files that are copied: the same bytes, the same layer

_PINS = """\
Package: *\\nPin: release n=bookworm\\nPin-Priority: 1001\\n\\n\
Package: *\\nPin: release n=bookworm-security\\nPin-Priority: 1001\\n"""
"""A base that has security updates already goes back to what its release had, where that suite is off."""

_APT = """\
RUN printf '{sources}' > /etc/apt/sources.list && rm -f /etc/apt/sources.list.d/* \\
 && printf '{pins}' > /etc/apt/preferences.d/bench \\
 && apt-get -q update \\
 && DEBIAN_FRONTEND=noninteractive apt-get -q --yes --allow-downgrades dist-upgrade \\
 && DEBIAN_FRONTEND=noninteractive apt-get -q --yes --allow-downgrades --no-install-recommends install {packages} \\
 && rm -rf /var/lib/apt/lists/* /var/cache/apt/archives/*.deb
"""

_PIP = f"""\
RUN --mount=type=bind,target=/wheels \\
    pip install --no-index --find-links /wheels --break-system-packages {" ".join(WHEELS)}
"""


@dataclass(frozen=True, kw_only=True)
class Part:
    """One layer: what it stands on, the lines that make it, and the folder they copy from."""

    name: str
    below: str
    lines: str
    context: Path | None = None
    again: int = 0  # the same lines, built another time


@dataclass(frozen=True, kw_only=True)
class Images:
    """What there is to ship: by variant, as the stack names it and as this desktop has it."""

    platform: str

    def named(self, variant: str) -> str:
        """As a Compose file says it."""
        return f"{NAME}:{variant}"

    def layers(self, variant: str) -> tuple[str, ...]:
        """The diff IDs of its layers, lowest first."""
        said = docker("image", "inspect", "--format", "{{json .RootFS.Layers}}", self.named(variant))
        return tuple(json.loads(said))


def ensure(*, say: Callable[[str], None]) -> Images:
    """Have all variants in this desktop's Docker; minutes where they are missing, no time where they are there."""
    platform = desktop_platform()
    base = debian_base.ensure(SUITE, platform, say=say)
    with tempfile.TemporaryDirectory(prefix="fleetbench") as folder:
        recipes = {base: docker("image", "inspect", "--format", "{{.Id}}", base)}
        for part in _parts(base, Path(folder), say=say):
            recipes[part.name] = _ensure(part, recipes[part.below], base, say=say)
    for variant in VARIANTS:
        docker("tag", _tag(variant), tagged_for(_tag(variant), platform))
    return Images(platform=platform)


def cache() -> Path:
    """Where what is expensive to make is kept between runs."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet"


def _tag(name: str) -> str:
    return f"{NAME}:{name}"


def _parts(base: str, folder: Path, *, say: Callable[[str], None]) -> tuple[Part, ...]:
    main = f"deb {debian_base.MIRROR}/debian bookworm main\\n"
    both = f"{main}deb {debian_base.MIRROR}/debian-security bookworm-security main\\n"
    wheels, model = _wheels(say=say), _model(folder / "model")
    code, changed = _code(folder / "code"), _code(folder / "changed", change="# one more line\n")
    parts: list[Part] = []

    def chain(ending: str, sources: str, packages: str) -> None:
        lines = _APT.format(sources=sources, pins=_PINS, packages=packages)
        parts.append(Part(name=f"apt{ending}", below=base, lines=lines))
        parts.append(Part(name=f"pip{ending}", below=f"apt{ending}", lines=_PIP, context=wheels))

    def top(variant: str, below: str, code: Path = code) -> None:
        if not any(part.name == f"model-{below}" for part in parts):
            lines = "COPY model.bin /\n"
            parts.append(Part(name=f"model-{below}", below=below, lines=lines, context=model))
        lines = 'COPY . /app/\nSTOPSIGNAL SIGKILL\nCMD ["sleep", "infinity"]\n'
        parts.append(Part(name=variant, below=f"model-{below}", lines=lines, context=code))

    chain("", main, _PACKAGES)
    chain("-more", main, f"{_PACKAGES} python3-requests")
    chain("-sec", both, _PACKAGES)
    parts.append(Part(name="pip-again", below="apt", lines=_PIP, context=wheels, again=1))
    top("v1", "pip")
    top("v2code", "pip", changed)
    top("v2apt", "pip-more")
    top("v2sec", "pip-sec")
    top("v2pip", "pip-again")
    return tuple(parts)


def _ensure(part: Part, below: str, base: str, *, say: Callable[[str], None]) -> str:
    """Build a part unless it is there, made from the same; its recipe."""
    said = (below, part.lines, str(part.again), _content(part.context) if part.context else "")
    recipe = hashlib.sha256("\0".join(said).encode()).hexdigest()
    label = f'{{{{index .Config.Labels "{LABEL}"}}}}'
    if docker_or_none("image", "inspect", "--format", label, _tag(part.name)) == recipe:
        return recipe
    say(f"building {_tag(part.name)}")
    with tempfile.TemporaryDirectory(prefix="fleetbench") as empty:
        dockerfile = Path(empty) / "Dockerfile"
        under = base if part.below == base else _tag(part.below)
        dockerfile.write_text(f"FROM {under}\n{part.lines}", encoding="utf-8")
        names = ("--tag", _tag(part.name), "--label", f"{LABEL}={recipe}", "--file", str(dockerfile))
        # What is built again must be new, and an apt layer of last month's cache is no layer of today.
        command = (*buildkit_client(), "build", "--no-cache", "--progress", "plain", *names)
        _run(*command, str(part.context or empty))
    return recipe


def _content(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(folder)}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _wheels(*, say: Callable[[str], None]) -> Path:
    """The wheels for Debian's Python, downloaded once, with the person's own settings of pip."""
    machine = os.uname().machine
    name = hashlib.sha256(" ".join((*WHEELS, machine)).encode()).hexdigest()[:8]
    folder = cache() / f"bench-wheels-{DEBIAN_ARCHITECTURES[desktop_platform()]}-{name}"
    if not folder.is_dir():
        say("downloading wheels (57 MB, once)")
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as unfinished:
            kinds = (f"--platform=manylinux{kind}_{machine}" for kind in ("2014", "_2_17", "_2_28"))
            which = ("--no-deps", "--only-binary=:all:", "--python-version=3.11", *kinds)
            pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--quiet")
            _run(*pip, *which, "--dest", f"{unfinished}/wheels", *WHEELS)
            (Path(unfinished) / "wheels").rename(folder)
    return folder


def _model(folder: Path) -> Path:
    folder.mkdir()
    return _dated(folder, "model.bin", random.Random(1).randbytes(_MODEL_SIZE))  # noqa: S311  the same each time


def _code(folder: Path, *, change: str = "") -> Path:
    """Python's own modules, up to 2 MB: code as people write it, to compress as code does."""
    folder.mkdir()
    size = 0
    for path in sorted(Path(sysconfig.get_path("stdlib")).glob("*.py")):
        text = path.read_bytes()
        if (size := size + len(text)) <= _CODE_SIZE:
            _dated(folder, path.name, text)
    return _dated(folder, "main.py", f"import time\n{change}time.sleep(1e9)\n".encode())


def _dated(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    for one in (path, folder):
        os.utime(one, (_DATE, _DATE))
    return folder


def _run(*argv: str) -> None:
    done = subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(argv[:4])} ... failed: {done.stderr.strip()[-600:]}")
