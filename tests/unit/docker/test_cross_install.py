"""What `docker/cross-install.sh` refuses before it fetches anything."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "docker/cross-install.sh"
RELEASE = Path("/etc/os-release").read_text(encoding="utf-8")


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
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/os-release").write_text(release)
    (tmp_path / "var/lib/dpkg").mkdir(parents=True)
    status = f"Package: apt\nArchitecture: all\n\nPackage: dpkg\nStatus: x\nArchitecture: {architecture}\n\n"
    (tmp_path / "var/lib/dpkg/status").write_text(status)
    command = (
        "sh",
        str(SCRIPT),
        "--development",
        "--keys",
        "x",
        "arm64",
        str(tmp_path),
        str(tmp_path / "to"),
    )
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, len(done.stderr.splitlines())) == (1, 1)
    assert words in done.stderr
