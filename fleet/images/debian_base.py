"""Where does a Debian base image come from? From a registry; without one, from mmdebstrap.

The result is a local image named ``fleet-debian:<suite>-<architecture>``.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import selectors
import subprocess
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fleet.errors import DesktopError, UsageError
from fleet.images.docker_cli import docker, docker_or_none, refusal
from fleet.images.emulation import runs
from fleet.platforms import DEBIAN_ARCHITECTURES

if TYPE_CHECKING:
    from collections.abc import Callable

MIRROR = "http://deb.debian.org"
REGISTRY_ANSWERS_IN = 8.0  # seconds; a reachable registry describes the image within one or two
NEWEST_FILE = (
    "1735689600"  # 2025-01-01: what the build itself writes is dated so, for the same bytes every time
)
PULL_TAKES = 600.0  # seconds, for 30 MB over a slow line
BOOTSTRAP_TAKES = 1800.0  # seconds, for 100 MB over a slow line and emulated unpacking

# Files that a container never reads; Debian's own slim images leave out the same ones.
_LEFT_OUT = tuple(
    f"--dpkgopt={rule}"
    for rule in (
        "path-exclude=/usr/share/doc/*",
        "path-include=/usr/share/doc/*/copyright",
        "path-exclude=/usr/share/info/*",
        "path-exclude=/usr/share/locale/*",
        "path-exclude=/usr/share/man/*",
    )
)


@dataclass(frozen=True, kw_only=True)
class Base:
    """One Debian release for one platform."""

    suite: str
    platform: str

    @property
    def architecture(self) -> str:
        """The platform's name in dpkg. Raises ``UsageError`` for an unknown platform."""
        if self.platform not in DEBIAN_ARCHITECTURES:
            raise UsageError(
                f"there is no Debian base for platform {self.platform}",
                cure=f"use one of {', '.join(DEBIAN_ARCHITECTURES)}",
            )
        return DEBIAN_ARCHITECTURES[self.platform]

    @property
    def tag(self) -> str:
        """The local image's name."""
        return f"fleet-debian:{self.suite}-{self.architecture}"


def ensure(suite: str, platform: str, *, say: Callable[[str], None]) -> str:
    """Make sure the base image is here, and return the name to use after ``FROM``.

    Raises ``DesktopError`` if neither a registry nor mmdebstrap can provide it.
    """
    base = Base(suite=suite, platform=platform)
    if _recorded_platform(base.tag) == platform:
        return base.tag
    if _pull(base, say=say):
        return base.tag
    rootfs = cached_rootfs(base)
    if not rootfs.exists():
        say(
            f"{base.tag}: no registry answers, building it from Debian's archive (half a minute to a few minutes)"
        )
        bootstrap(base, rootfs, say=say)
    _load(base, rootfs)
    return base.tag


def cached_rootfs(base: Base) -> Path:
    """The path of the cached root file system, shared by all clones. A changed recipe gets another name."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fleet"
    parts = (*_bootstrap_command(base, Path("-")), NEWEST_FILE)
    recipe = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:8]
    return cache / f"debian-{base.suite}-{base.architecture}-{recipe}.tar"


def bootstrap(base: Base, rootfs: Path, *, say: Callable[[str], None] = print) -> None:
    """Build the root file system with mmdebstrap, whole or not at all. Raises ``DesktopError``.

    If the archive's security suite contradicts itself for this architecture, as a mirror does while it is renewed, the
    system is built without that suite, and ``say`` is told.
    """
    if not runs(base.platform):
        raise DesktopError(
            f"this computer cannot run {base.platform} programs, which building {base.tag} needs",
            cure="install the packages qemu-user-static and binfmt-support",
        )
    rootfs.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=rootfs.parent) as folder:
        # A user namespace's root must be able to reach the folder.
        Path(folder).chmod(0o755)
        unfinished = Path(folder) / "rootfs.tar"
        try:
            _run_mmdebstrap(base, unfinished)
        except DesktopError as problem:
            if not _security_is_broken(problem.what):
                raise
            say(f"{base.tag}: the archive's security suite contradicts itself; building without it")
            unfinished.unlink(missing_ok=True)
            _run_mmdebstrap(base, unfinished, security=False)
        unfinished.replace(rootfs)


def _security_is_broken(text: str) -> bool:
    return "unexpected size" in text.lower()


def _run_mmdebstrap(base: Base, rootfs: Path, *, security: bool = True) -> None:
    command = _bootstrap_command(base, rootfs)[: None if security else -1]
    environment = os.environ | {"SOURCE_DATE_EPOCH": NEWEST_FILE}
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=BOOTSTRAP_TAKES,
            check=False,
            env=environment,
        )
    except FileNotFoundError:
        raise DesktopError(
            f"{base.tag} cannot be had: no registry answers, and mmdebstrap is not installed",
            cure="install the mmdebstrap package",
        ) from None
    except subprocess.TimeoutExpired:
        raise DesktopError(
            f"building {base.tag} did not finish in {BOOTSTRAP_TAKES:g} s",
            cure=f"see whether {MIRROR} answers",
        ) from None
    if done.returncode:
        raise _bootstrap_refusal(base, done.stderr.decode(errors="replace"))


def _bootstrap_command(base: Base, rootfs: Path) -> tuple[str, ...]:
    mode = "root" if os.geteuid() == 0 else "unshare"
    suite = base.suite
    return (
        *(
            "mmdebstrap",
            f"--mode={mode}",
            "--variant=minbase",
            "--format=tar",
            f"--architectures={base.architecture}",
        ),
        *_LEFT_OUT,
        # Bookworm would merge /usr with a package that needs Perl: 45 MB, which no container reads.
        "--hook-dir=/usr/share/mmdebstrap/hooks/maybe-merged-usr",
        # Those two are copies of the desktop's; Docker brings its own.
        '--customize-hook=rm -f "$1/etc/hostname" "$1/etc/resolv.conf"',
        *(suite, str(rootfs)),
        f"deb {MIRROR}/debian {suite} main",
        f"deb {MIRROR}/debian {suite}-updates main",
        f"deb {MIRROR}/debian-security {suite}-security main",
    )


# What mmdebstrap and apt say when they cannot, and what cures it.
_CURES = (
    (("mirror sync in progress", "unexpected size"), "the archive is being renewed: try again in an hour"),
    (
        ("resolve", "failed to fetch", "could not connect", "timed out"),
        f"see whether {MIRROR} can be reached from here",
    ),
    (("newuidmap", "newgidmap", "subuid", "unshare"), "install the uidmap package, or run this once as root"),
    (("no_pubkey", "not signed", "keyring"), "install the debian-archive-keyring package"),
    (("no space left",), "free some disk"),
    (("permission denied",), "see whether /tmp is mounted noexec, and set TMPDIR to a folder that is not"),
)


def _bootstrap_refusal(base: Base, said: str) -> DesktopError:
    lines = said.splitlines()
    known = (
        (line, cure)
        for words, cure in _CURES
        for line in lines
        if any(word in line.lower() for word in words)
    )
    last = [line for line in lines if line.startswith("E:")] or lines or ["it said nothing"]
    reason, cure = next(known, (last[-1], ""))
    return DesktopError(f"building {base.tag} with mmdebstrap failed: {reason[:300]}".rstrip("."), cure=cure)


def write_archive(rootfs: Path, base: Base, out: IO[bytes]) -> None:
    """Pack a root file system as a ``docker load`` archive; the same input gives the same bytes.

    ``docker import --platform`` would be shorter, and Docker 20.10 records the desktop's architecture with it.
    """
    with rootfs.open("rb") as layer:
        diff_id = hashlib.file_digest(layer, "sha256").hexdigest()
    config = json.dumps(_config(base, diff_id), sort_keys=True).encode()
    name = f"{hashlib.sha256(config).hexdigest()}.json"
    manifest = json.dumps([{"Config": name, "RepoTags": [base.tag], "Layers": ["layer.tar"]}]).encode()
    with (
        tarfile.open(fileobj=out, mode="w|", format=tarfile.PAX_FORMAT) as archive,
        rootfs.open("rb") as layer,
    ):
        archive.addfile(_entry(name, len(config)), io.BytesIO(config))
        archive.addfile(_entry("layer.tar", rootfs.stat().st_size), layer)
        archive.addfile(_entry("manifest.json", len(manifest)), io.BytesIO(manifest))


def _config(base: Base, diff_id: str) -> dict[str, object]:
    _, architecture, *variant = base.platform.split("/")
    created = "1970-01-01T00:00:00Z"
    return {
        "architecture": architecture,
        **({"variant": variant[0]} if variant else {}),
        "os": "linux",
        "created": created,
        "config": {
            "Cmd": ["bash"],
            "Env": ["PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"],
        },
        "history": [{"created": created, "created_by": f"mmdebstrap {base.suite} {base.architecture}"}],
        "rootfs": {"type": "layers", "diff_ids": [f"sha256:{diff_id}"]},
    }


def _entry(name: str, size: int) -> tarfile.TarInfo:
    entry = tarfile.TarInfo(name)
    entry.size = size
    return entry


def _load(base: Base, rootfs: Path) -> None:
    with tempfile.TemporaryFile() as archive:
        write_archive(rootfs, base, archive)
        archive.seek(0)
        docker("load", "--quiet", stdin=archive, timeout=600)
    if _recorded_platform(base.tag) != base.platform:
        raise DesktopError(
            f"Docker recorded {base.tag} as {_recorded_platform(base.tag)}, not {base.platform}",
            cure="update Docker Engine",
        )


def _recorded_platform(image: str) -> str | None:
    """The platform a local image says it is for, or None without such an image."""
    said = docker_or_none("image", "inspect", "--format", "{{.Os}}/{{.Architecture}}/{{.Variant}}", image)
    # 64-bit ARM has one variant, v8, which some builders write down and some do not.
    return said.rstrip("/").removesuffix("/v8") if said else None


def _pull(base: Base, *, say: Callable[[str], None]) -> bool:
    """Try a registry; whether the image came from one. The person's own tag ends as it was."""
    official = f"debian:{base.suite}-slim"
    before = docker_or_none("image", "inspect", "--format", "{{.Id}}", official)
    if not _pull_answers(official, base.platform, say=say):
        return False
    docker("tag", official, base.tag)
    docker("tag", before, official) if before else docker("rmi", official)
    return _recorded_platform(base.tag) == base.platform


def _pull_answers(image: str, platform: str, *, say: Callable[[str], None]) -> bool:
    """Pull, giving up at once where no registry names the image quickly."""
    with subprocess.Popen(
        ("docker", "pull", "--platform", platform, image),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as pull:
        assert pull.stdout is not None  # noqa: S101 - for the type checker: PIPE was asked for
        try:
            if (
                not _speaks(pull.stdout, within=REGISTRY_ANSWERS_IN)
                or b"Pulling from" not in pull.stdout.readline()
            ):
                return False
            say(f"pulling {image} for {platform}")
            output, _ = pull.communicate(timeout=PULL_TAKES)
        except subprocess.TimeoutExpired:
            return False
        finally:
            pull.kill()
    if pull.returncode:
        say(str(refusal("pull", output)))
    return pull.returncode == 0


def _speaks(stream: IO[bytes], *, within: float) -> bool:
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return bool(selector.select(within))
