from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet import onboard
from fleet.diagnosis.explain import explain

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = [
    pytest.mark.skipif(not Path("/usr/lib/apt/apt-helper").exists(), reason="needs apt"),
    pytest.mark.usefixtures("desktop"),  # they wait long
]

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
    environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}
    argv = ("sh", "-c", onboard.text("apt_reach.sh"), "apt_reach", "3")
    return subprocess.run(argv, env=environment, capture_output=True, text=True, check=False, timeout=60)


@contextlib.contextmanager
def answering(answer: bytes) -> Iterator[str]:
    """A package server of this computer that says this much to each request, and keeps the connection open."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        connections = []

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    connections.append(connection)
                    connection.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/debian"
        server.shutdown(socket.SHUT_RDWR)
        for connection in connections:
            connection.close()


NOT_FOUND = b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"
BEGINS = b"HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\n" + b"Origin: Debian\n" * 4096
WHOLE = b"HTTP/1.1 200 OK\r\nContent-Length: 15\r\n\r\nOrigin: Debian\n"


@pytest.mark.parametrize("answer", [WHOLE, NOT_FOUND])
def test_one_archive_that_answers_is_enough(tmp_path: Path, answer: bytes) -> None:
    """The others may be down for a while, and are named; apt itself tells what is wrong with an answer."""
    with answering(answer) as url:
        done = run(tmp_path, NO_PORT, "http://nosuch.invalid/debian", url)
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(done.stdout.splitlines()) == [
        "note: Could not connect to 127.0.0.1; other package servers answer",
        "note: Could not resolve host: nosuch.invalid; other package servers answer",
    ]


def test_a_slow_server_is_one_that_answers(tmp_path: Path) -> None:
    """Its list does not arrive within the seconds, but a part of it does."""
    with answering(BEGINS) as url:
        done = run(tmp_path, url)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_server_that_only_takes_connections_is_named_within_seconds(tmp_path: Path) -> None:
    """apt itself would wait for minutes; all servers are asked at the same time."""
    started = time.monotonic()
    with answering(b"") as url, answering(b"") as other, answering(WHOLE) as good:
        alone = run(tmp_path, url, other)
        beside = run(tmp_path, url, good)
    assert time.monotonic() - started < 20
    sites = [one.removeprefix("http://").removesuffix("/debian") for one in (url, other)]
    assert alone.returncode == 1
    assert sorted(alone.stderr.splitlines()) == sorted(
        f"package server {site} does not answer within 3 s" for site in sites
    )
    what, cure = explain(alone.stderr, verb="provision")
    first = alone.stderr.split()[2]
    assert what == f"the server {first} does not answer"
    assert "another server" in cure
    assert (beside.returncode, beside.stdout) == (
        0,
        f"note: package server {sites[0]} does not answer within 3 s; other package servers answer\n",
    )


def test_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was downloaded lay in a temporary folder."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    with answering(WHOLE) as url:
        assert run(tmp_path, url).returncode == 0
    assert list((tmp_path / "temporary").iterdir()) == []


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
