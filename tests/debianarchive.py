"""Does Debian's archive have what a test needs? While a mirror is renewed, its lists do not fit its index."""

from __future__ import annotations

import re
import urllib.error
import urllib.request
from functools import cache

import pytest

from fleet import debian
from fleet.debian import Base
from fleet.dockercli import docker_or_none

SUITE = "bookworm"


def needed(platform: str, *, for_base_only: bool = False) -> None:
    """Skip a test that would build for a platform for which nobody can build just now; say why.

    One that needs a base only can do with the one that was made before.
    """
    base = Base(suite=SUITE, platform=platform)
    there = for_base_only and docker_or_none("image", "inspect", "--format", "{{.Id}}", base.tag)
    if not there and (reason := _inconsistency(base.architecture)):
        pytest.skip(reason)


@cache
def _inconsistency(architecture: str) -> str:
    """In what the archive contradicts itself, as apt would find out; "" where it does not."""
    index = f"{debian.MIRROR}/debian-security/dists/{SUITE}-security"
    path = f"main/binary-{architecture}/Packages.xz"
    try:
        with urllib.request.urlopen(f"{index}/InRelease", timeout=20) as answer:  # noqa: S310  a constant
            listed = re.search(
                rf"^ [0-9a-f]{{64}} +([0-9]+) {re.escape(path)}$", answer.read().decode(), re.MULTILINE
            )
        request = urllib.request.Request(f"{index}/{path}", method="HEAD")  # noqa: S310
        with urllib.request.urlopen(request, timeout=20) as answer:  # noqa: S310
            size = answer.headers["Content-Length"]
    except urllib.error.URLError:
        return ""  # then the test itself tells what is wrong
    if listed and size and listed[1] != size:
        return f"Debian's archive is being renewed: {path} has {size} bytes, and its index says {listed[1]}"
    return ""
