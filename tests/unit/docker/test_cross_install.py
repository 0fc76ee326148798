"""What `docker/cross-install.sh` refuses before it fetches anything, and what it does in place of maintainer scripts."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "docker/cross-install.sh"
RELEASE = Path("/etc/os-release").read_text(encoding="utf-8")
LIB = "/usr/lib/aarch64-linux-gnu"

BLAS = f"""#!/bin/sh
set -e
update-alternatives --install {LIB}/libblas.so.3 \\
\t            libblas.so.3-aarch64-linux-gnu {LIB}/blas/libblas.so.3 10
"""
OPENBLAS = f"""#!/bin/sh
if [ "$1" = configure ]; then
        update-alternatives --install {LIB}/libblas.so.3 libblas.so.3-aarch64-linux-gnu {LIB}/openblas/libblas.so.3 100
update-alternatives \\
\t--install {LIB}/libblas.so libblas.so-aarch64-linux-gnu {LIB}/openblas/libblas.so 100 \\
\t--slave {LIB}/libblas.a libblas.a-aarch64-linux-gnu {LIB}/openblas/libblas.a \\
\t--slave /usr/share/man/man1/x.1.gz x.1.gz /usr/share/man/man1/openblas.1.gz
        update-alternatives --install /usr/bin/there there {LIB}/openblas/libblas.so.3 100
fi
"""
"""As libblas3 and libopenblas0-pthread of Debian bookworm have them, shortened."""


def base(folder: Path, *, release: str = RELEASE, architecture: str = "arm64") -> Path:
    """The files of a base image."""
    (folder / "etc").mkdir(parents=True)
    (folder / "etc/os-release").write_text(release)
    (folder / "var/lib/dpkg").mkdir(parents=True)
    status = f"Package: apt\nArchitecture: all\n\nPackage: dpkg\nStatus: x\nArchitecture: {architecture}\n\n"
    (folder / "var/lib/dpkg/status").write_text(status)
    return folder


def program(folder: Path, name: str, text: str) -> None:
    """Put a program before those of this computer."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\n{text}\n")
    (folder / name).chmod(0o755)


def cross_install(
    *arguments: str | Path, programs: Path = Path("/nowhere")
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ("sh", str(SCRIPT), *map(str, arguments)),
        env={**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("release", "architecture", "words"),
    [
        (RELEASE, "armhf", "the base is for armhf, and the image is for arm64. Cure: name a base of that"),
        ("VERSION_CODENAME=sarge\n", "arm64", "BUILD_BASE and RUN_BASE must be the same Debian release"),
    ],
)
def test_a_base_that_does_not_fit_is_one_sentence(
    tmp_path: Path, release: str, architecture: str, words: str
) -> None:
    """A 32-bit base for a 64-bit platform, and one of another release."""
    base(tmp_path, release=release, architecture=architecture)
    done = cross_install("--development", "--keys", "x", "arm64", tmp_path, tmp_path / "to")
    assert (done.returncode, len(done.stderr.splitlines())) == (1, 1)
    assert words in done.stderr


def test_an_unknown_dependency_is_told(tmp_path: Path) -> None:
    """The sentence is what the program prints in place of the names."""
    program(tmp_path / "bin", "apt-get", "exit 0")
    program(tmp_path / "bin", "python3", "echo 'no package is known for x. Cure: y'; exit 1")
    to = base(tmp_path / "base")
    done = cross_install("--keys", "x", "arm64", to, tmp_path / "to", programs=tmp_path / "bin")
    assert (done.returncode, done.stdout, done.stderr) == (1, "no package is known for x. Cure: y\n", "")


def package(archives: Path, name: str, postinst: str, *files: str) -> None:
    """Make a package of Debian."""
    top = archives / "top"
    for file in files:
        (top / file.lstrip("/")).parent.mkdir(parents=True, exist_ok=True)
        (top / file.lstrip("/")).write_text(f"{name}\n")
    (top / "DEBIAN").mkdir(parents=True)
    control = (
        f"Package: {name}\nVersion: 1\nArchitecture: all\nMaintainer: x <x@example.org>\nDescription: x\n"
    )
    (top / "DEBIAN/control").write_text(control)
    if postinst:
        (top / "DEBIAN/postinst").write_text(postinst)
        (top / "DEBIAN/postinst").chmod(0o755)
    command = ("dpkg-deb", "--build", "--root-owner-group", str(top), str(archives / f"{name}.deb"))
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    shutil.rmtree(top)


@pytest.mark.skipif(not shutil.which("dpkg-deb"), reason="packages are made by dpkg-deb")
@pytest.mark.parametrize("development", [True, False], ids=["sysroot", "image"])
def test_what_maintainer_scripts_would_do(tmp_path: Path, *, development: bool) -> None:
    """Alternatives are linked, by priority; what has another name or is not there is left out. Certificates are one file."""
    archives, to = tmp_path / "archives", base(tmp_path / "base")
    archives.mkdir()
    package(archives, "libblas3", BLAS, f"{LIB}/blas/libblas.so.3", "/usr/lib/python3/x.py", "/usr/bin/there")
    package(
        archives, "libopenblas", OPENBLAS, *(f"{LIB}/openblas/libblas.{end}" for end in ("so.3", "so", "a"))
    )
    certificates = (f"/usr/share/ca-certificates/mozilla/{name}.crt" for name in ("One", "Two"))
    package(archives, "ca-certificates", "", *certificates, "/usr/share/doc/ca-certificates/copyright")
    take = f'case $* in *install*) cp {archives}/*.deb "${{APT_CONFIG%/*}}/archives" ;; esac'
    program(tmp_path / "bin", "apt-get", take)
    target = to if development else tmp_path / "target"
    flags = ("--development",) if development else ()
    done = cross_install(*flags, "arm64", to, target, "libopenblas", programs=tmp_path / "bin")
    assert done.returncode == 0, done.stderr
    found = {
        path.name: str(path.readlink())
        for path in (target / "usr").rglob("*")
        if path.is_symlink() and "aarch64" in str(path)
    }
    assert found == {f"libblas.{end}": f"openblas/libblas.{end}" for end in ("so.3", "so", "a")}
    assert (target / "usr/bin/there").read_text() == "libblas3\n"
    assert (target / "etc/ssl/certs/ca-certificates.crt").read_text() == "ca-certificates\n" * 2
    assert not (target / "usr/share/man").exists()
