from __future__ import annotations

import contextlib
import os
import socket
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NO_PORT = "http://127.0.0.1:1/debian"


def run(folder: Path, *urls: str, config: str = "") -> subprocess.CompletedProcess[str]:
    """Run the script with an apt that has these archives and this configuration."""
    lines = "\n".join(f"'{url}/InRelease' file 0" for url in urls)
    programs = {
        "apt-get": f"cat <<'EOT'\n{lines}\nEOT",
        "apt-config": f"cat <<'EOT'\n{config}\nEOT",
    }
    for name, script in programs.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    environment = {"PATH": f"{folder}:{os.environ['PATH']}"}
    argv = ("sh", "-c", onboard.text("apt_reach.sh"))
    return subprocess.run(argv, env=environment, capture_output=True, text=True, check=False, timeout=60)


@contextlib.contextmanager
def listening() -> Iterator[str]:
    """An archive of this computer."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}/debian"


def test_one_archive_that_answers_is_enough(tmp_path: Path) -> None:
    """The others may be down for a while."""
    with listening() as url:
        done = run(tmp_path, NO_PORT, "http://nosuch.invalid/debian", url)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("url", "error"),
    [
        (NO_PORT, "Could not connect to 127.0.0.1"),
        ("http://nosuch.invalid/debian", "Could not resolve host: nosuch.invalid"),
        ("https://nosuch.invalid/debian", "Could not resolve host: nosuch.invalid"),
        ("https://nosuch.invalid:8443/debian", "Could not resolve host: nosuch.invalid"),
    ],
)
def test_no_archive_that_answers_is_an_error(tmp_path: Path, url: str, error: str) -> None:
    """The sentence names the last one."""
    done = run(tmp_path, url)
    assert (done.returncode, done.stderr) == (1, f"{error}\n")


@pytest.mark.parametrize(
    ("urls", "config"),
    [
        ((), ""),
        (("file:/srv/debian",), ""),
        ((NO_PORT,), 'Acquire::http::Proxy "http://proxy:3128";'),
        ((NO_PORT,), 'Acquire::https::Proxy::deb.debian.org "http://proxy:3128";'),
    ],
)
def test_what_cannot_be_checked_passes(tmp_path: Path, urls: tuple[str, ...], config: str) -> None:
    """Archives without a host, and those that a proxy reaches."""
    assert run(tmp_path, *urls, config=config).returncode == 0
