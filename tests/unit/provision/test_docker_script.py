from __future__ import annotations

import hashlib
import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Docker
from fleet.errors import DesktopError, FleetError, UsageError
from fleet.provision import docker_script

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

GOOD = b"""#!/bin/sh
set -e
do_install() {
    echo "installing"
}
# wrapped up in a function so that we have some protection against only getting half the file
do_install
"""
LOGIN_PAGE = b"<!DOCTYPE html><html><body>Welcome to our guest Wi-Fi</body></html>\n"


@contextmanager
def serving(answer: Callable[[BaseHTTPRequestHandler], None]) -> Iterator[str]:
    """A web server on loopback that answers with ``answer``; its URL."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            answer(self)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        server.block_on_close = False
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/get-docker.sh"
        server.shutdown()


def sends(body: bytes, *, announced: int | None = None) -> Callable[[BaseHTTPRequestHandler], None]:
    def answer(request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.send_header("Content-Length", str(len(body) if announced is None else announced))
        request.end_headers()
        request.wfile.write(body)

    return answer


def fetched(url: str, tmp_path: Path, *, sha256: str | None = None, timeout: float = 20) -> bytes:
    return docker_script.fetch(url, sha256=sha256, base=tmp_path, timeout=timeout)


def test_a_url_is_fetched(tmp_path: Path) -> None:
    """Byte for byte."""
    with serving(sends(GOOD)) as url:
        assert fetched(url, tmp_path) == GOOD


def test_a_redirect_is_followed(tmp_path: Path) -> None:
    """As get.docker.com and mirrors do."""

    def away(request: BaseHTTPRequestHandler) -> None:
        request.send_response(302)
        request.send_header("Location", target)
        request.send_header("Content-Length", "0")
        request.end_headers()

    with serving(sends(GOOD)) as target, serving(away) as url:
        assert fetched(url, tmp_path) == GOOD


def test_a_page_that_is_not_there_is_named(tmp_path: Path) -> None:
    """Its body is no script, whatever it looks like."""
    with serving(lambda request: request.send_error(404)) as url, pytest.raises(DesktopError) as refused:
        fetched(url, tmp_path)
    assert refused.value.what == f"{url} answers 404 Not Found"


@pytest.mark.parametrize(
    ("code", "cure"),
    [
        (403, "correct `script:` under `docker:`"),
        (404, "correct `script:` under `docker:`"),
        (407, "https_proxy"),
        (410, "correct `script:` under `docker:`"),
        (429, "wait some minutes"),
        (500, "wait some minutes"),
        (503, "wait some minutes"),
    ],
)
def test_a_server_that_answers_an_error_was_reached(code: int, cure: str, tmp_path: Path) -> None:
    """So the cure is not to check the internet, and not the verb that was just run alone."""
    with serving(lambda request: request.send_error(code)) as url, pytest.raises(DesktopError) as refused:
        fetched(url, tmp_path)
    assert refused.value.what.startswith(f"{url} answers {code} ")
    assert cure in refused.value.cure
    assert "internet" not in refused.value.cure
    assert "fab provision" not in refused.value.cure


def test_a_download_that_breaks_off_is_refused(tmp_path: Path) -> None:
    """Also where what came ends at a line's end, and would pass for a script."""
    with (
        serving(sends(b"#!/bin/sh\necho hello\n", announced=5000)) as url,
        pytest.raises(DesktopError, match="stopped after 21 bytes"),
    ):
        fetched(url, tmp_path)


def test_a_chunked_download_that_breaks_off_is_refused(tmp_path: Path) -> None:
    """A body without an announced length says itself where it ends."""

    def half(request: BaseHTTPRequestHandler) -> None:
        request.wfile.write(
            b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\na\r\n#!/bin/sh\n\r\n5\r\nec"
        )

    with serving(half) as url, pytest.raises(DesktopError, match=r"stopped after|cannot be fetched"):
        fetched(url, tmp_path)


@pytest.mark.parametrize("trickles", [False, True])
def test_a_slow_server_is_given_up(trickles: bool, tmp_path: Path) -> None:
    """One that says nothing, and one that says a byte now and then for ever."""
    ended = threading.Event()

    def slowly(request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.send_header("Content-Length", "200")
        request.end_headers()
        while not ended.wait(0.05):
            if trickles:
                request.wfile.write(b"#")
                request.wfile.flush()

    started = time.monotonic()
    with serving(slowly) as url:
        with pytest.raises(DesktopError, match=r"did not arrive within 0\.5 s"):
            fetched(url, tmp_path, timeout=0.5)
        ended.set()
    assert time.monotonic() - started < 5


def test_a_server_that_is_not_there(tmp_path: Path) -> None:
    """Nobody listens at the address."""
    with serving(sends(GOOD)) as url:
        pass
    with pytest.raises(DesktopError, match=r"cannot be fetched: .*Connection refused"):
        fetched(url, tmp_path)


def test_a_name_that_does_not_exist(tmp_path: Path) -> None:
    """A typo in the inventory, or no DNS."""
    with pytest.raises(DesktopError, match=r"http://nosuch\.invalid/x cannot be fetched: "):
        fetched("http://nosuch.invalid/x", tmp_path)


def test_a_body_without_end_is_not_kept(tmp_path: Path) -> None:
    """What a server sends is bounded."""
    with (
        serving(sends(b"#!/bin/sh\n" + b"#" * 3_000_000 + b"\n")) as url,
        pytest.raises(UsageError, match="larger than 2 MB"),
    ):
        fetched(url, tmp_path)


def test_a_path_is_relative_to_the_inventory(tmp_path: Path) -> None:
    """And an absolute one is itself."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "x.sh").write_bytes(GOOD)
    assert fetched("sub/x.sh", tmp_path) == fetched(str(tmp_path / "sub/x.sh"), tmp_path / "sub") == GOOD


def test_a_file_that_is_not_there_is_a_mistake(tmp_path: Path) -> None:
    """The person's: exit code 2."""
    with pytest.raises(UsageError, match=r"cannot be read from .*/x\.sh: No such file") as refused:
        fetched("x.sh", tmp_path)
    assert "script:" in refused.value.cure
    with pytest.raises(UsageError, match="Is a directory"):
        fetched(".", tmp_path)


def test_a_pinned_script_passes(tmp_path: Path) -> None:
    """In capital digits too."""
    (tmp_path / "x.sh").write_bytes(GOOD)
    digest = hashlib.sha256(GOOD).hexdigest()
    assert fetched("x.sh", tmp_path, sha256=digest.upper()) == GOOD


def test_another_script_than_the_pinned_one_is_refused(tmp_path: Path) -> None:
    """The error names its checksum, so that a user who has read it can pin it."""
    (tmp_path / "x.sh").write_bytes(GOOD)
    with pytest.raises(UsageError, match=hashlib.sha256(GOOD).hexdigest()):
        fetched("x.sh", tmp_path, sha256="0" * 64)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "it is empty"),
        (b"\n \n", "it is empty"),
        (LOGIN_PAGE, "it begins with '<!DOCTYPE html>"),
        (b"#!/bin/sh\necho \0\n", "it contains binary data"),
        (b"#!/bin/sh\nif true; then\n  echo\n", "sh:"),
        (b"#!/bin/sh\ncase x in\n", "sh:"),
    ],
)
def test_what_is_no_whole_script_is_refused(content: bytes, problem: str, tmp_path: Path) -> None:
    """A network's login page has the address and the status of the real thing."""
    (tmp_path / "x.sh").write_bytes(content)
    with pytest.raises(UsageError) as refused:
        fetched("x.sh", tmp_path)
    assert f"x.sh is not a complete shell script: {problem}" in refused.value.what
    assert "correct the file" in refused.value.cure


def test_a_login_page_over_the_network_has_a_cure(tmp_path: Path) -> None:
    """The person can see it in a browser."""
    with serving(sends(LOGIN_PAGE)) as url, pytest.raises(UsageError, match="login page"):
        fetched(url, tmp_path)


def test_dockers_script_is_refused_wherever_it_is_cut(tmp_path: Path) -> None:
    """Any cut once its function has begun: between lines, inside one, and just before the call at the end."""
    starts = GOOD.index(b"do_install()") + len(b"do_install()")
    for end in range(starts, len(GOOD)):
        (tmp_path / "x.sh").write_bytes(GOOD[:end])
        with pytest.raises(FleetError):
            fetched("x.sh", tmp_path)
    (tmp_path / "x.sh").write_bytes(GOOD)
    assert fetched("x.sh", tmp_path) == GOOD


def test_robots_share_what_was_fetched(tmp_path: Path) -> None:
    """One robot or two hundred: the script is read once, and what one robot got all get."""
    (tmp_path / "install.sh").write_bytes(GOOD)
    scripts = docker_script.Scripts(base=tmp_path)
    wanted = Docker(script="install.sh")
    assert scripts.fetch(wanted) == GOOD
    (tmp_path / "install.sh").unlink()
    assert scripts.fetch(wanted) == GOOD
