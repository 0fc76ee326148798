from __future__ import annotations

import subprocess
import tarfile
from typing import TYPE_CHECKING

import pytest

from fleet.images import debian_base
from fleet.images.emulation import desktop_platform, runs
from tests.support import debian_archive as debianarchive

if TYPE_CHECKING:
    from pathlib import Path


def docker(*arguments: str) -> str:
    return subprocess.run(("docker", *arguments), capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize(("platform", "machine"), [("linux/arm64", "aarch64"), ("linux/arm/v7", "armv7l")])
def test_a_foreign_base_is_what_it_says(platform: str, machine: str) -> None:
    """The recorded platform and the programs inside agree."""
    if not runs(platform):
        pytest.fail(f"this computer cannot run {platform}: run docker/desktop.sh", pytrace=False)
    tag = debianarchive.base(platform)
    recorded = docker("image", "inspect", "--format", "{{.Os}}/{{.Architecture}}/{{.Variant}}", tag)
    assert recorded.rstrip("/").removesuffix("/v8") == platform
    assert docker("run", "--rm", "--platform", platform, tag, "uname", "-m") in {machine, "armv8l"}


def test_a_base_that_is_there_is_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The second time nothing is said, pulled, built or written."""
    debian_base.ensure("trixie", desktop_platform(), say=print)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    said: list[str] = []
    debian_base.ensure("trixie", desktop_platform(), say=said.append)
    assert (said, list(tmp_path.iterdir())) == ([], [])


def test_a_base_is_slim_and_carries_nothing_of_the_desktop() -> None:
    """No package lists, no manual pages; the name and the resolver are Docker's to give, at start."""
    tag = debian_base.ensure("trixie", desktop_platform(), say=print)
    container = docker("create", tag)
    with (
        subprocess.Popen(("docker", "export", container), stdout=subprocess.PIPE) as export,
        tarfile.open(fileobj=export.stdout, mode="r|") as content,
    ):
        sizes = {entry.name: entry.size for entry in content if entry.isfile()}
    docker("rm", container)
    unread = (
        "var/lib/apt/lists/",
        "var/cache/apt/",
        "usr/share/man/",
        "usr/share/locale/",
        "usr/share/info/",
    )
    assert sum(size for name, size in sizes.items() if name.startswith(unread)) < 100_000
    assert [sizes.get(name, 0) for name in ("etc/hostname", "etc/resolv.conf")] == [0, 0]
    assert sum(sizes.values()) < 130e6
