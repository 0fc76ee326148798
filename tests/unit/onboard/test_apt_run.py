from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet.diagnosis.explain import explain
from fleet.provision import apt
from fleet.robot.facts import Facts, Login

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("desktop")  # they wait long

ROOT = Facts(login=Login(sudo="root"))


def run(
    *argv: str, lock_timeout: int = 20, limit: int = 20, pause: int = 5, silence: int = 20, answer: int = 2
) -> subprocess.CompletedProcess[str]:
    """The very argv of the step, run by the desktop's own shell: apt itself is not needed for it."""
    step = apt.run(
        "x",
        argv,
        facts=ROOT,
        bounds=apt.Bounds(
            lock_timeout=lock_timeout, limit=limit, pause=pause, silence=silence, answer=answer
        ),
    )
    return subprocess.run(step.argv, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize("code", [0, 1, 100])
def test_output_and_exit_code_come_through(code: int) -> None:
    """Also of a command that ends at once, before anybody listens."""
    for _ in range(10):
        done = run("sh", "-c", f"echo one; echo two >&2; exit {code}")
        assert (done.returncode, done.stdout, done.stderr) == (code, "one\ntwo\n", "")


def test_arguments_stay_whole() -> None:
    """Spaces, quotes and dollars are only text."""
    assert run("printf", "%s|", "a b", "'\"", "$(date)", "*").stdout == "a b|'\"|$(date)|*|"


def test_apt_is_told_to_wait_for_dpkgs_locks() -> None:
    """By a configuration of its own, which reaches the apt that a script runs."""
    assert 'DPkg::Lock::Timeout "7"' in run("sh", "-c", 'cat "$APT_CONFIG"', lock_timeout=7).stdout


def test_a_command_that_does_not_end_is_ended() -> None:
    """Also one that ignores the first request, with all that it started; the sentence says so."""
    started = time.monotonic()
    done = run("sh", "-c", "trap '' TERM; sleep 5432 & while :; do sleep 5432; done", limit=1)
    assert (done.returncode, done.stdout) == (1, "the command did not end within 1 s, and was stopped\n")
    assert time.monotonic() - started < 15
    assert subprocess.run(("pgrep", "-f", "[s]leep 5432"), capture_output=True, check=False).returncode == 1


@pytest.mark.parametrize(
    "message",
    [
        "E: Could not get lock /var/lib/apt/lists/lock. It is held by process 12 (apt-get)",
        "dpkg: error: dpkg frontend lock was locked by /usr/bin/dpkg process with pid 12",
        "dpkg: error: dpkg frontend lock was locked by another process with pid 12",
    ],
)
def test_while_apt_is_locked_it_is_tried_again(message: str, tmp_path: object) -> None:
    """The lock of the package lists is the one that apt does not wait for."""
    script = f'[ -e "$0" ] && exit 0; touch "$0"; echo "{message}" >&2; exit 100'
    started = time.monotonic()
    done = run("sh", "-c", script, f"{tmp_path}/tried", pause=1)
    assert (done.returncode, done.stdout) == (
        0,
        f"{message}\nnow: another program uses apt; trying again in 1 s\n",
    )
    assert time.monotonic() - started > 1


def test_a_lock_that_stays_is_the_end() -> None:
    """The waiting time is bounded, and the last output is apt's."""
    done = run(
        "sh", "-c", "echo 'E: Could not get lock /x. It is held by process 1 (y)'; exit 100", lock_timeout=0
    )
    assert (done.returncode, done.stdout.count("Could not get lock")) == (100, 1)


def test_another_failure_is_not_tried_again() -> None:
    """It would only fail again."""
    assert run("sh", "-c", "echo no; exit 3").stdout == "no\n"


@contextlib.contextmanager
def silent() -> Iterator[str]:
    """The address of a server that does not answer."""
    with socket.create_server(("127.0.0.1", 0), backlog=64) as server:
        yield f"localhost:{server.getsockname()[1]}"


def apt_get(folder: Path, *sources: str) -> tuple[str, ...]:
    """A real `apt-get update` as Docker's script runs it, with these sources and folders of its own."""
    (folder / "lists/partial").mkdir(parents=True, exist_ok=True)
    (folder / "sources.list").write_text(
        "".join(f"deb [trusted=yes] {source} trixie main\n" for source in sources)
    )
    own = {
        "Dir::Etc::SourceList": folder / "sources.list",
        "Dir::Etc::SourceParts": "/dev/null",
        "Dir::State::lists": folder / "lists",
        "Dir::Cache": folder,
    }
    options = (word for key, value in own.items() for word in ("-o", f"{key}={value}"))
    return (
        "sh",
        "-c",
        '"$@" > /dev/null; apt-get install --simulate docker-ce',
        "sh",
        "apt-get",
        *options,
        "-qq",
        "update",
    )


@pytest.mark.skipif(not shutil.which("apt-get"), reason="needs apt")
def test_a_silent_package_server_is_named_within_a_minute(tmp_path: Path) -> None:
    """By apt itself, whose own limits would take minutes; what it could not install is not the cause."""
    assert 4 * apt.Bounds().answer < 50
    started = time.monotonic()
    with silent() as site:
        done = run(*apt_get(tmp_path, f"http://{site}/debian"), limit=100, silence=100)
    assert time.monotonic() - started < 4 * 2 + 30  # four times the limit, and some time for slow computers
    assert done.returncode
    assert f"Failed to fetch http://{site}/debian" in done.stdout
    what, cure = explain(done.stdout, code=done.returncode, verb="provision")
    assert what == "the server localhost does not answer"
    assert "another server" in cure


@pytest.mark.skipif(not shutil.which("apt-get"), reason="needs apt")
def test_a_long_silence_is_told_and_ends_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many lists of one server would take apt that many times its limit."""
    monkeypatch.setenv("FLEET_TELL", "1")
    with silent() as site:
        done = run(*apt_get(tmp_path, f"http://{site}/debian"), limit=100, silence=3, answer=10)
    *notes, last = done.stdout.splitlines()
    assert done.returncode == 1
    assert notes[-2:] == [
        f"now: waiting for package server 127.0.0.1: nothing has arrived for {seconds} s"
        for seconds in (1, 2)
    ]
    assert last == "package server 127.0.0.1 sends nothing for 3 s"
    assert "does not answer" in explain(done.stdout, verb="provision")[0]


@pytest.mark.skipif(not shutil.which("curl"), reason="needs curl")
def test_curl_does_not_wait_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """Docker's script gives it no limit; its line in the output names the server."""
    monkeypatch.setenv("FLEET_TELL", "2")
    with silent() as site:
        script = f"echo '+ sh -c curl -fsSL \"http://{site}/gpg\" -o x'; exec curl -fsSL http://{site}/gpg"
        done = run("sh", "-c", script, limit=100, silence=100)
    assert done.returncode == 28
    assert "now: waiting for package server localhost: nothing has arrived for 2 s\n" in done.stdout
    what, _ = explain(done.stdout, code=28, verb="provision")
    assert what == "the server localhost does not answer"


def test_the_logins_own_curl_settings_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as a proxy."""
    monkeypatch.setenv("CURL_HOME", str(tmp_path))
    (tmp_path / ".curlrc").write_text("proxy = http://proxy:3128")
    lines = run("sh", "-c", 'cat "$CURL_HOME/.curlrc"').stdout.splitlines()
    assert lines == [
        "proxy = http://proxy:3128",
        "connect-timeout = 2",
        "speed-limit = 1",
        "speed-time = 4",
    ]


def test_a_command_that_takes_long_shows_how_far_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Megabytes while they arrive; the time in any case."""
    monkeypatch.setenv("FLEET_TELL", "1")
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    (tmp_path / "du").write_text(
        f'#!/bin/sh\necho x >> {tmp_path}/count\necho "$(wc -l < {tmp_path}/count)000 /var/lib/apt/lists"\n'
    )
    (tmp_path / "du").chmod(0o755)
    assert run("sleep", "3.5").stdout.splitlines() == [
        f"now: downloading, {seconds} MB in {seconds} s" for seconds in (1, 2, 3)
    ]
    (tmp_path / "du").write_text("#!/bin/sh\n")
    assert run("sleep", "2.5").stdout.splitlines() == [
        f"now: working, {seconds} s so far" for seconds in (1, 2)
    ]
    (tmp_path / "dpkg").symlink_to(shutil.which("sleep") or "")
    assert run("dpkg", "1.5").stdout == "now: installing packages, 1 s so far\n"


def test_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The script keeps apt's configuration and output in a temporary folder, whose path may contain blanks."""
    folder = tmp_path / "a b"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    assert "Lock::Timeout" in run("sh", "-c", 'cat "$APT_CONFIG"').stdout
    assert list(folder.iterdir()) == []
