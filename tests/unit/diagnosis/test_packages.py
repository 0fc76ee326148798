from __future__ import annotations

import shutil
import subprocess

import pytest

from fleet.diagnosis.packages import PACKAGES

ALTERNATIVES = {"awk", "iptables", "ip6tables", "python3"}
"""Links that Debian's alternatives make, and python3, which is in python3-minimal, a part of python3."""


@pytest.mark.skipif(not shutil.which("dpkg-query"), reason="needs a Debian to compare with")
def test_packages_are_those_of_debian() -> None:
    """Each command that is installed here belongs to the package of the table."""
    listed = subprocess.run(
        ("dpkg-query", "-W", "-f", "${Package}\n"), capture_output=True, text=True, check=True
    ).stdout.split()
    compared = 0
    for package in sorted(set(PACKAGES.values()) & set(listed)):
        files = subprocess.run(
            ("dpkg-query", "-L", package), capture_output=True, text=True, check=True
        ).stdout.split()
        names = {path.rpartition("/")[2] for path in files if "/bin/" in path or "/sbin/" in path}
        ours = {command for command, of in PACKAGES.items() if of == package} - ALTERNATIVES
        assert ours <= names, package
        compared += len(ours)
    assert compared > 40
