"""Where does Docker's convenience script come from, and is it whole?

The desktop fetches it, once for all robots: a robot without internet access to that host still gets it, and what runs
as root on robots can be looked at, and pinned by its checksum, first.
"""

from __future__ import annotations

import hashlib
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

PATIENCE = 20.0
"""Seconds for the whole download: the script has 23 kB."""

LARGEST = 2_000_000
"""Bytes; whatever is larger is something else."""

_PIECE = 64 * 1024


def fetch(source: str, *, sha256: str | None, base: Path, patience: float = PATIENCE) -> bytes:
    """The script at ``source``: a URL, or a path relative to the folder ``base``. ``patience`` is in seconds.

    Raises:
        DesktopError: it cannot be fetched from here, or arrived cut off.
        Mistake: there is no such file, it is no shell script, or it is not the one that ``sha256`` pins.

    """
    is_url = urlsplit(source).scheme in ("http", "https")
    script = _download(source, patience=patience) if is_url else _read(base / source)
    if sha256 and (digest := hashlib.sha256(script).hexdigest()) != sha256.lower():
        raise UsageError(
            f"{source} is not the script that the inventory pins: its sha256 is {digest}",
            cure="read what has changed; if you trust it, put this checksum into the inventory",
        )
    if trouble := _trouble(script):
        cure = "open it in a browser: a network's login page may answer in its place" if is_url else ""
        raise UsageError(f"{source} is not a whole shell script: {trouble}", cure=cure)
    return script


class Scripts:
    """The scripts that robots need, each fetched once, when the first robot needs it; from any thread."""

    def __init__(self, *, base: Path) -> None:
        self._base = base
        self._fetched: dict[Docker, bytes] = {}
        self._one_at_a_time = threading.Lock()

    def fetch(self, wanted: Docker) -> bytes:
        """The script that the inventory names for a robot; raises as `fetch` does."""
        with self._one_at_a_time:
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


def _download(url: str, *, patience: float) -> bytes:
    """The body of what ``url`` answers, in time and whole."""
    cure = f"see whether this computer has internet (`curl -I {url}`), or save the script and name its path instead"
    try:
        # The scheme was checked: http or https.
        with urllib.request.urlopen(url, timeout=patience) as answer:  # noqa: S310
            return _body(answer, deadline=time.monotonic() + patience)
    except urllib.error.HTTPError as problem:
        problem.close()
        raise DesktopError(f"{url} answers {problem.code} {problem.reason}", cure=cure) from None
    except TimeoutError:
        raise DesktopError(f"{url} did not arrive within {patience:g} s", cure=cure) from None
    except http.client.IncompleteRead as problem:
        raise DesktopError(
            f"{url} broke off after {len(problem.partial)} bytes", cure="run the same command again"
        ) from None
    except (OSError, http.client.HTTPException, ValueError) as problem:
        reason = problem.reason if isinstance(problem, urllib.error.URLError) else problem
        raise DesktopError(f"{url} cannot be fetched: {reason}", cure=cure) from None


def _body(answer: http.client.HTTPResponse, *, deadline: float) -> bytes:
    """Read piece by piece: a server that sends a byte now and then would never run into the socket's time-out.

    ``read1`` does not say when a body ended before its announced length, so that is compared here.
    """
    announced = answer.length
    body = bytearray()
    while len(body) <= LARGEST and (piece := answer.read1(_PIECE)):
        body += piece
        if time.monotonic() > deadline:
            raise TimeoutError
    if announced is not None and len(body) < min(announced, LARGEST):
        raise http.client.IncompleteRead(bytes(body), announced - len(body))
    return bytes(body)


def _trouble(script: bytes) -> str:
    """What is wrong with it; "" where nothing is seen. A cut is seen where it leaves something open, or half a line."""
    first = script.partition(b"\n")[0][:60].decode(errors="replace").strip()
    wraps = b"\ndo_install()" in script
    signs = (
        (not script.strip(), "it is empty"),
        (not script.startswith(b"#!"), f"it begins with {first!r}, not with #!"),
        (len(script) > LARGEST, f"it is larger than {LARGEST // 1_000_000} MB"),
        (b"\0" in script, "it holds binary data"),
        (not script.endswith(b"\n"), "it ends in the middle of a line"),
        # Docker's own wraps its work in this function and calls it last, so that half a script does nothing.
        (
            wraps and script.split()[-1] != b"do_install",
            "it was cut off before its last line, which calls do_install",
        ),
    )
    return next((said for is_so, said in signs if is_so), "") or _syntax(script)


def _syntax(script: bytes) -> str:
    """What the shell says about it, without running it."""
    try:
        parsed = subprocess.run(
            ("sh", "-n"), input=script, capture_output=True, timeout=PATIENCE, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as problem:
        raise DesktopError(f"sh cannot check Docker's script on this computer: {problem}") from None
    return parsed.stderr.decode(errors="replace").strip().splitlines()[-1] if parsed.returncode else ""
