import hashlib
import io
import json
import tarfile
from pathlib import Path

import pytest

from fleet.errors import DesktopError, UsageError
from fleet.images.debian_base import Base, bootstrap, cached_rootfs, write_archive
from fleet.images.emulation import desktop_platform


@pytest.fixture
def rootfs(tmp_path: Path) -> Path:
    """A very small root file system."""
    path = tmp_path / "rootfs.tar"
    with tarfile.open(path, "w") as archive:
        entry = tarfile.TarInfo("etc/debian_version")
        entry.size = 5
        archive.addfile(entry, io.BytesIO(b"13.1\n"))
    return path


def packed(rootfs: Path, base: Base) -> bytes:
    out = io.BytesIO()
    write_archive(rootfs, base, out)
    return out.getvalue()


def content(archive: bytes) -> dict[str, bytes]:
    with tarfile.open(fileobj=io.BytesIO(archive)) as opened:
        members = {member.name: opened.extractfile(member) for member in opened}
        return {name: file.read() for name, file in members.items() if file}


@pytest.mark.parametrize(
    ("platform", "tag", "architecture", "variant"),
    [
        ("linux/amd64", "fleet-debian:trixie-amd64", "amd64", None),
        ("linux/arm64", "fleet-debian:trixie-arm64", "arm64", None),
        ("linux/arm/v7", "fleet-debian:trixie-armhf", "arm", "v7"),
    ],
)
def test_the_archive_says_which_platform_it_is_for(
    rootfs: Path, platform: str, tag: str, architecture: str, variant: str | None
) -> None:
    """A base with the wrong architecture recorded sends builds to a registry."""
    parts = content(packed(rootfs, Base(suite="trixie", platform=platform)))
    (image,) = json.loads(parts["manifest.json"])
    config = json.loads(parts[image["Config"]])
    assert image["RepoTags"] == [tag]
    assert (config["os"], config["architecture"], config.get("variant")) == ("linux", architecture, variant)


def test_the_archive_holds_the_root_file_system_under_its_checksum(rootfs: Path) -> None:
    """Docker refuses a layer whose bytes are not the promised ones."""
    parts = content(packed(rootfs, Base(suite="trixie", platform="linux/arm64")))
    (image,) = json.loads(parts["manifest.json"])
    (layer,) = image["Layers"]
    assert parts[layer] == rootfs.read_bytes()
    diff_id = f"sha256:{hashlib.sha256(parts[layer]).hexdigest()}"
    assert json.loads(parts[image["Config"]])["rootfs"]["diff_ids"] == [diff_id]


def test_the_same_root_file_system_gives_the_same_archive(rootfs: Path) -> None:
    """Two desktops with the same base have the same image, so robots need it once."""
    base = Base(suite="bookworm", platform="linux/arm64")
    first = packed(rootfs, base)
    rootfs.touch()
    assert packed(rootfs, base) == first


def test_a_platform_debian_does_not_serve_is_refused() -> None:
    """The error names the ones that work."""
    with pytest.raises(
        UsageError,
        match=r"no Debian base for platform linux/riscv64; use one of linux/arm64, linux/arm/v7, linux/amd64",
    ):
        _ = Base(suite="trixie", platform="linux/riscv64").tag


def test_the_cache_is_outside_the_clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fresh clone on the same desktop finds it, and each base has a file of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    arm = cached_rootfs(Base(suite="bookworm", platform="linux/arm64"))
    assert arm.parent == tmp_path / "fleet"
    assert arm == cached_rootfs(Base(suite="bookworm", platform="linux/arm64"))
    assert arm != cached_rootfs(Base(suite="bookworm", platform="linux/arm/v7"))
    assert arm != cached_rootfs(Base(suite="trixie", platform="linux/arm64"))


def stand_in(folder: Path, script: str) -> None:
    program = folder / "mmdebstrap"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)


def test_without_mmdebstrap_the_cure_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The person learns that a registry would have done, too."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        DesktopError, match=r"no registry answers, and mmdebstrap is not installed; install the mmdebstrap"
    ):
        bootstrap(Base(suite="trixie", platform=desktop_platform()), tmp_path / "cache" / "rootfs.tar")


@pytest.mark.parametrize(
    ("says", "cure"),
    [
        (
            "E: Failed to fetch http://deb.debian.org/debian/x  Temporary failure resolving 'deb.debian.org'",
            "reached",
        ),
        ("E: newuidmap is not installed or not in PATH", "uidmap"),
        ("W: GPG error: NO_PUBKEY 6ED0E7B82643E131", "debian-archive-keyring"),
        ("chroot: failed to run command dpkg: Permission denied", "noexec"),
    ],
)
def test_a_failed_bootstrap_says_why_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, says: str, cure: str
) -> None:
    """A half-written base in the cache would be taken for a whole one the next time."""
    stand_in(
        tmp_path, f'for a; do case "$a" in *.tar) echo half > "$a" ;; esac; done; echo "{says}" >&2; exit 25'
    )
    monkeypatch.setenv("PATH", str(tmp_path))
    rootfs = tmp_path / "cache" / "rootfs.tar"
    with pytest.raises(DesktopError) as caught:
        bootstrap(Base(suite="trixie", platform=desktop_platform()), rootfs)
    assert says in caught.value.what
    assert cure in caught.value.cure
    assert list(rootfs.parent.iterdir()) == []


def test_a_foreign_base_needs_emulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Said before mmdebstrap starts, which would fail half a minute later."""
    monkeypatch.setattr("fleet.images.debian_base.runs", lambda _platform: False)
    with pytest.raises(
        DesktopError, match=r"cannot run linux/arm64 programs.*; install the packages qemu-user-static"
    ):
        bootstrap(Base(suite="trixie", platform="linux/arm64"), tmp_path / "rootfs.tar")
