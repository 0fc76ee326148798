from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from fleet import onboard

if TYPE_CHECKING:
    from pathlib import Path

DIGEST = f"sha256:{'1' * 64}"
CONFIG = f"sha256:{'2' * 64}"
MANIFEST = json.dumps({"config": {"digest": CONFIG}, "layers": []})
IMAGE = ("robots/talker", DIGEST, "222222222222", "talker:fleet-222222222222", CONFIG)

DOCKER = r"""#!/bin/sh
# An engine of files: pulled/NAME holds an image's ID.
echo "$*" >>"$BOX/calls"
mkdir -p "$BOX/images"
file() { printf '%s/images/%s' "$BOX" "$(printf %s "$1" | tr '/:' '__')"; }
case $1 in
    pull)
        for reference; do :; done
        [ -z "${DOCKER_CONFIG-}" ] || {
            cp -p "$DOCKER_CONFIG/config.json" "$BOX/seen"
            stat -c %a "$DOCKER_CONFIG" "$DOCKER_CONFIG/config.json" >"$BOX/modes"
            printf %s "$DOCKER_CONFIG" >"$BOX/where"
        }
        [ ! -e "$BOX/slow" ] || exec sleep 60
        [ ! -e "$BOX/fails" ] || { cat "$BOX/fails" >&2; exit 1; }
        cat "$BOX/gives" >"$(file "$reference")"
        ;;
    image)
        case $2 in
            inspect) for reference; do :; done; cat "$(file "$reference")" 2>/dev/null ;;
            rm) rm "$(file "$3")" ;;
        esac
        ;;
    tag) cp "$(file "$2")" "$(file "$3")" ;;
    create) echo container ;;
    context) echo unix:///nowhere ;;
esac
"""


@dataclass(frozen=True, kw_only=True)
class Pi:
    """A robot's home and its engine."""

    home: Path
    box: Path

    def start(self, *, token: str = "one", login: str = "") -> subprocess.Popen[bytes]:  # noqa: S107
        arguments = (token, "tim@desktop", "fleet/incoming", "3", "", *IMAGE)
        argv = ("sh", "-c", onboard.text("pull_images.sh"), "pull_images", *arguments)
        path = f"{self.home.parent / 'bin'}:{os.environ['PATH']}"
        environment = {
            "PATH": path,
            "HOME": str(self.home),
            "BOX": str(self.box),
            "XDG_RUNTIME_DIR": str(self.box / "memory"),
        }
        process = subprocess.Popen(
            argv,
            cwd=self.home,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        assert process.stdin
        process.stdin.write(f"reg.local:5000\n{login}\n{MANIFEST}\n".encode())
        process.stdin.flush()
        return process

    def pull(self, **values: str) -> tuple[int, str]:
        """Run the script to its end, with an input that stays open."""
        process = self.start(**values)
        code = process.wait(20)
        assert process.stderr
        said = process.stderr.read().decode().strip()
        for pipe in (process.stdin, process.stdout, process.stderr):
            if pipe:
                pipe.close()
        return code, said

    def images(self) -> set[str]:
        return {path.name for path in (self.box / "images").iterdir()}

    def kept(self, folder: str) -> dict[str, str]:
        return {path.name: path.read_text() for path in (self.home / ".fleet" / folder).iterdir()}


@pytest.fixture
def pi(home: Path) -> Pi:
    box = home.parent / "box"
    (box / "memory").mkdir(parents=True)
    (box / "gives").write_text(CONFIG)
    docker = home.parent / "bin" / "docker"
    docker.write_text(DOCKER)
    docker.chmod(0o755)
    return Pi(home=home, box=box)


@pytest.mark.parametrize("id_", [CONFIG, DIGEST])
def test_an_image_is_pulled_by_digest_and_gets_its_name(pi: Pi, id_: str) -> None:
    """The ID is that of the configuration or of the manifest; the name by which it was pulled goes."""
    (pi.box / "gives").write_text(id_)
    assert pi.pull() == (0, "")
    assert pi.images() == {"talker_fleet-222222222222"}
    assert pi.kept("receipts") == pi.kept("pulled") == {"222222222222": MANIFEST}
    assert f"pull --quiet reg.local:5000/robots/talker@{DIGEST}" in (pi.box / "calls").read_text()
    (pi.box / "fails").write_text("nobody asks")
    assert pi.pull() == (0, "")


def test_another_image_gets_no_name(pi: Pi) -> None:
    """Nothing is believed that was not compared."""
    (pi.box / "gives").write_text(f"sha256:{'3' * 64}")
    code, said = pi.pull()
    assert (code, "arrived as another image: sha256:333" in said) == (1, True)
    assert "talker_fleet-222222222222" not in pi.images()
    assert pi.kept("receipts") == {}


def test_a_refusal_is_told_and_names_of_earlier_attempts_go_later(pi: Pi) -> None:
    """Their layers may be among those that are not pulled again."""
    (pi.box / "gives").write_text(f"sha256:{'3' * 64}")
    pi.pull()
    (pi.box / "fails").write_text("connection refused\n")
    assert pi.pull() == (1, "connection refused")
    assert len(pi.images()) == 1
    (pi.box / "fails").unlink()
    (pi.box / "gives").write_text(CONFIG)
    assert pi.pull() == (0, "")
    assert pi.images() == {"talker_fleet-222222222222"}


def test_a_login_is_only_in_memory_and_only_while_it_pulls(pi: Pi) -> None:
    """For the login user alone; whether the pull succeeds, fails, or is ended."""
    login = '{"auths":{"reg.local:5000":{"auth":"x"}}}'
    for fails in (False, True):
        if fails:
            (pi.home / ".fleet/stop").touch()
            (pi.box / "fails").write_text("unauthorized\n")
            for path in (pi.box / "images").iterdir():
                path.unlink()
        pi.pull(login=login)
        assert (pi.box / "seen").read_text() == f"{login}\n"
        assert (pi.box / "modes").read_text().split() == ["700", "600"]
        assert (pi.box / "where").read_text().startswith(str(pi.box / "memory"))
        assert list((pi.box / "memory").iterdir()) == []
    assert login not in (pi.box / "calls").read_text()


def wait_for(path: Path) -> None:
    deadline = time.monotonic() + 10
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert path.exists()


def test_a_connection_that_closes_ends_the_pull(pi: Pi) -> None:
    """The login goes with it, and the next attempt need not wait."""
    (pi.box / "slow").touch()
    process = pi.start(login="{}")
    wait_for(pi.box / "where")
    assert process.stdin
    process.stdin.close()
    assert process.wait(10) == 74
    assert list((pi.box / "memory").iterdir()) == []
    for pipe in (process.stdout, process.stderr):
        assert pipe
        pipe.close()
    (pi.box / "slow").unlink()
    assert pi.pull(token="two")[0] == 0  # noqa: S106


def test_one_transfer_at_a_time(pi: Pi) -> None:
    """Another run waits, and is told who is at work; the same run takes over at once what it had begun."""
    (pi.box / "slow").touch()
    first = pi.start()
    wait_for(pi.box / "calls")
    code, said = pi.pull(token="two")  # noqa: S106
    assert (code, said) == (75, "tim@desktop is shipping to this robot")
    (pi.box / "slow").unlink()
    assert pi.pull()[0] == 0
    assert first.wait(10) in (74, -signal.SIGTERM)
    for pipe in (first.stdin, first.stdout, first.stderr):
        assert pipe
        pipe.close()
