from __future__ import annotations

import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.lab.conftest import Lab

SCRIPT = Path(__file__).parents[2] / "docker" / "desktop.sh"


def engine() -> str:
    return subprocess.run(
        ("docker", "info", "--format", "{{.ID}}"), capture_output=True, text=True, check=True
    ).stdout


def packages() -> float:
    return Path("/var/lib/dpkg/status").stat().st_mtime


def test_a_ready_desktop_is_left_alone_without_a_word() -> None:
    """Nothing of the person's is touched."""
    before = engine(), packages()
    done = subprocess.run(("sh", str(SCRIPT)), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (engine(), packages()) == before


def test_a_bare_desktop_gets_what_it_lacks_once(own_lab: Lab) -> None:
    """A blank Pi is a bare Debian computer: its user ends up with a Docker that builds, and a second run is silent."""
    (pi,) = own_lab.pis
    first = pi.ssh("cat > desktop.sh; sh desktop.sh", stdin=SCRIPT.read_bytes(), timeout=900)
    assert first.returncode == 0, first.stderr.decode()
    (installing,) = [line for line in first.stdout.decode().splitlines() if "installing with apt-get" in line]
    assert {"docker.io", "mmdebstrap", "python3-venv"} <= set(installing.split())
    ready = pi.ssh(
        "docker version && docker buildx version && mmdebstrap --version && python3 -c 'import ensurepip'"
    )
    assert ready.returncode == 0, ready.stderr.decode()
    second = pi.ssh("sh desktop.sh")
    assert (second.returncode, second.stdout) == (0, b"")
    # The same computer, where Docker is somebody else's: who may use it is not for this script to decide.
    pi.exec("sh", "-c", "setfacl -b /var/run/docker.sock && gpasswd -d pi docker")
    third = pi.ssh("sh desktop.sh")
    assert third.returncode == 1
    assert b"this login may not use it. Cure: sudo usermod -aG docker pi" in third.stderr
    assert b"docker" not in pi.ssh("id -nG").stdout.split()
