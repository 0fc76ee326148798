"""Fetch Docker's convenience script, and check that it is complete.

The desktop fetches the script, once for all robots. So a robot that cannot reach the script's host still gets it, and the
user can read what will run as root, and pin it by its checksum, first.
"""

from __future__ import annotations

import hashlib
import http
import http.client
import subprocess
import threading
import time
import urllib.error
import urllib.request
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from fleet.errors import DesktopError, UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.config.inventory import Docker

TIMEOUT = 20.0
"""Seconds for the whole download; the script has 23 kB."""

LARGEST = 2_000_000
"""Bytes; a larger file is not the script."""

_CHUNK = 64 * 1024

_KEY = "`script:` under `docker:` in the inventory"
_LOGIN_PAGE = "open the URL in a browser: the login page of a network may answer instead"
_OTHER_FILE = f"correct the file, or {_KEY}; Docker's own is at https://get.docker.com"


def fetch(source: str, *, sha256: str | None, base: Path, timeout: float = TIMEOUT) -> bytes:
    """The script at ``source``: a URL, or a path relative to the folder ``base``. ``timeout`` is in seconds.

    Raises:
        DesktopError: the script cannot be fetched, or the download is incomplete.
        UsageError: the file is missing, is not a shell script, or does not have the checksum ``sha256``.

    """
    is_url = urlsplit(source).scheme in ("http", "https")
    script = _download(source, timeout=timeout) if is_url else _read(base / source)
    if sha256 and (digest := hashlib.sha256(script).hexdigest()) != sha256.lower():
        raise UsageError(
            f"{source} is not the script that the inventory pins: its sha256 is {digest}",
            cure="read what has changed in the script; if you trust it, put this checksum into the inventory",
        )
    if problem := _problem(script):
        cure = _LOGIN_PAGE if is_url else _OTHER_FILE
        raise UsageError(f"{source} is not a complete shell script: {problem}", cure=cure)
    return script


class Scripts:
    """The scripts that robots need. Each is fetched once, when the first robot needs it; from any thread."""

    def __init__(self, *, base: Path) -> None:
        self._base = base
        self._fetched: dict[Docker, bytes] = {}
        self._lock = threading.Lock()

    def fetch(self, wanted: Docker) -> bytes:
        """The script that the inventory names for a robot. Raises like `fetch`."""
        with self._lock:
            if wanted not in self._fetched:
                self._fetched[wanted] = fetch(wanted.script, sha256=wanted.sha256, base=self._base)
            return self._fetched[wanted]


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(LARGEST + 1)
    except OSError as problem:
        raise UsageError(
            f"Docker's script cannot be read from {path}: {problem.strerror or problem}",
            cure="correct `script:` under `docker:` in the inventory; a path there is relative to that file",
        ) from None


def _download(url: str, *, timeout: float) -> bytes:
    """The complete body of the response of ``url``."""
    cure = f"check that this computer has internet (`curl -I {url}`), or save the script and name its path instead"
    try:
        # `fetch` has checked the scheme: http or https.
        with urllib.request.urlopen(url, timeout=timeout) as response:  # noqa: S310
            return _body(response, deadline=time.monotonic() + timeout)
    except urllib.error.HTTPError as problem:
        problem.close()
        what = f"{url} answers {problem.code} {problem.reason}"
        raise DesktopError(what, cure=_cure_of(problem.code)) from None
    except TimeoutError:
        raise DesktopError(f"{url} did not arrive within {timeout:g} s", cure=cure) from None
    except http.client.IncompleteRead as problem:
        raise DesktopError(
            f"the download of {url} stopped after {len(problem.partial)} bytes",
            cure="run the same command again",
        ) from None
    except (OSError, http.client.HTTPException, ValueError) as problem:
        reason = problem.reason if isinstance(problem, urllib.error.URLError) else problem
        raise DesktopError(f"{url} cannot be fetched: {reason}", cure=cure) from None


def _body(response: http.client.HTTPResponse, *, deadline: float) -> bytes:
    """Read chunk by chunk: a server that sends a byte now and then would never exceed the socket's own timeout.

    ``read1`` does not report a body that ends before its announced length, so the length is compared here.
    """
    announced = response.length
    body = bytearray()
    while len(body) <= LARGEST and (chunk := response.read1(_CHUNK)):
        body += chunk
        if time.monotonic() > deadline:
            raise TimeoutError
    if announced is not None and len(body) < min(announced, LARGEST):
        raise http.client.IncompleteRead(bytes(body), announced - len(body))
    return bytes(body)


def _cure_of(status: int) -> str:
    """The cure if a server answers with an error: it was reached, so the network is well."""
    if status == http.HTTPStatus.PROXY_AUTHENTICATION_REQUIRED:
        return "the proxy of this computer wants a password: put it into https_proxy (http://USER:PASSWORD@HOST:PORT)"
    if status == http.HTTPStatus.TOO_MANY_REQUESTS or status >= http.HTTPStatus.INTERNAL_SERVER_ERROR:
        return f"wait some minutes, then run the same command again; or save the script and name its path as {_KEY}"
    return (
        f"correct {_KEY}: the server has no script at this address; Docker's own is at https://get.docker.com"
    )


def _problem(script: bytes) -> str:
    """What is wrong with the script; "" if nothing is detected.

    A truncated script is detected if it ends within a construct of the shell, or within a line.
    """
    first = script.partition(b"\n")[0][:60].decode(errors="replace").strip()
    wraps = b"\ndo_install()" in script
    problems = (
        (not script.strip(), "it is empty"),
        (not script.startswith(b"#!"), f"it begins with {first!r}, not with #!"),
        (len(script) > LARGEST, f"it is larger than {LARGEST // 1_000_000} MB"),
        (b"\0" in script, "it contains binary data"),
        (not script.endswith(b"\n"), "it ends in the middle of a line"),
        # Docker's script does everything in this function and calls it last, so that half a script does nothing.
        (
            wraps and script.split()[-1] != b"do_install",
            "it ends before its last line, which calls do_install",
        ),
    )
    return next((problem for applies, problem in problems if applies), "") or _syntax_error(script)


def _syntax_error(script: bytes) -> str:
    """The error that the shell reports for the script, without running it; "" for none."""
    try:
        parsed = subprocess.run(("sh", "-n"), input=script, capture_output=True, timeout=TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as problem:
        raise DesktopError(f"sh cannot check Docker's script on this computer: {problem}") from None
    return parsed.stderr.decode(errors="replace").strip().splitlines()[-1] if parsed.returncode else ""
