from __future__ import annotations

import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.images import debian_base
from fleet.lab import lifecycle
from tests.support.lab_project import LAB

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi

GET_DOCKER = Path(__file__).parents[2] / "fleet" / "lab" / "recipe" / "get-docker.sh"


def docker(*arguments: str) -> str:
    return subprocess.run(("docker", *arguments), capture_output=True, text=True, check=True).stdout.strip()


def host_key(pi: Pi) -> str:
    return pi.exec("cat", "/etc/ssh/ssh_host_ed25519_key.pub")


def booted(pi: Pi) -> str:
    """Wait for the boot to end; systemd's verdict. While the Pi restarts, Docker runs nothing in it."""
    script = "until systemctl is-system-running --wait 2>/dev/null | grep -E 'running|degraded'; do sleep 0.2; done"
    deadline = time.monotonic() + 60
    while True:
        try:
            return pi.exec("timeout", "60", "sh", "-c", script)
        except AssertionError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def test_a_pi_is_a_whole_computer(pi: Pi) -> None:
    """systemd is content: no unit failed."""
    assert (booted(pi), pi.exec("systemctl", "--failed", "--no-legend")) == ("running", "")


def test_a_pi_starts_without_docker(pi: Pi) -> None:
    """Installing it is what `provision` is for."""
    assert pi.ssh("command -v docker dockerd").returncode == 1


def test_a_pi_lets_the_labs_key_in_and_gives_root(pi: Pi) -> None:
    """As on Raspberry Pi OS: user pi, sudo without a password."""
    done = pi.ssh("whoami; sudo -n whoami; hostname")
    assert done.stdout.decode().split() == ["pi", "root", pi.name]


def test_every_pi_has_its_own_host_key(lab: Lab) -> None:
    """A key baked into the image would be everybody's."""
    assert len({host_key(pi) for pi in lab.pis}) == len(lab.pis)


def test_pis_reach_each_other_and_the_desktop_reaches_them(lab: Lab) -> None:
    """ROS talks from robot to robot, on ports of its choice."""
    one, two, *_ = lab.pis
    serve = "import socket; s = socket.create_server(('', 11311)); [s.accept()[0].sendall(b'hello') for _ in range(2)]"
    server = subprocess.Popen(("docker", "exec", two.container, "python3", "-c", serve))
    read = "import socket; print(socket.create_connection(('{}', 11311), timeout=5).recv(9).decode())"
    attempts = (
        f'for n in $(seq 50); do python3 -c "{read.format(two.name)}" 2>/dev/null && break; sleep 0.1; done'
    )
    try:
        assert one.exec("sh", "-c", attempts) == "hello"
        from_here = subprocess.run(
            ("python3", "-c", read.format(two.address)), capture_output=True, check=False
        )
        assert from_here.stdout == b"hello\n"
    finally:
        server.kill()
        server.wait()


def test_a_pi_shows_emulation_and_cannot_change_it(pi: Pi) -> None:
    """The handlers are the desktop's; a package installed on a Pi would replace them."""
    here = sorted(path.name for path in Path("/proc/sys/fs/binfmt_misc").iterdir())
    assert sorted(pi.exec("ls", "/proc/sys/fs/binfmt_misc").split()) == here
    assert b"Read-only" in pi.ssh("echo 1 | sudo tee /proc/sys/fs/binfmt_misc/status").stderr


def test_a_pi_cannot_set_the_desktops_clock(pi: Pi) -> None:
    """A container has no clock of its own."""
    assert pi.ssh("sudo date -s @0").returncode != 0


def started(lab: Lab) -> dict[str, str]:
    return {
        pi.name: docker("inspect", "--format", "{{.Id}} {{.State.StartedAt}}", pi.container) for pi in lab.pis
    }


def test_up_again_changes_nothing(lab: Lab) -> None:
    """The same command twice: what runs is left alone."""
    before = started(lab), lab.inventory.read_text()
    said: list[str] = []
    lifecycle.up(3, directory=lab.directory, name=lab.name, say=said.append)
    assert (started(lab), lab.inventory.read_text()) == before
    assert len(said) == 1


def test_up_starts_what_was_stopped(lab: Lab) -> None:
    """The same Pi comes back, with its address and its keys, and the others do not notice."""
    off = lab.pis[1]
    before, key = started(lab), host_key(off)
    docker("stop", "--time", "5", off.container)
    assert {pi.name: pi.state for pi in lifecycle.list_(name=lab.name)} == {
        "pi1": "running",
        "pi2": "exited",
        "pi3": "running",
    }
    lifecycle.up(3, directory=lab.directory, name=lab.name, say=print)
    after = started(lab)
    assert host_key(off) == key
    assert off.ssh("hostname").stdout == b"pi2\n"
    assert (after["pi1"], after["pi3"]) == (before["pi1"], before["pi3"])


def test_a_larger_count_adds_and_a_lost_pi_is_made_anew(own_lab: Lab) -> None:
    """A new Pi has a new host key, so what was recorded of the old one goes; other lines stay."""
    (old,) = own_lab.pis
    key = host_key(old)
    known = own_lab.directory / "known_hosts"
    known.write_text(f"{old.address} {key}\nexample.org {key}\n")
    docker("rm", "--force", old.container)
    lifecycle.up(2, directory=own_lab.directory, name=own_lab.name, say=print)
    assert [(pi.name, pi.state) for pi in lifecycle.list_(name=own_lab.name)] == [
        ("pi1", "running"),
        ("pi2", "running"),
    ]
    assert host_key(old) != key
    assert known.read_text() == f"example.org {key}\n"
    assert "pi2: {address: " in own_lab.inventory.read_text()


def test_a_lost_folder_is_made_anew(own_lab: Lab) -> None:
    """The Pis stay; the new key is let in."""
    for file in own_lab.directory.iterdir():
        file.unlink()
    lifecycle.up(1, directory=own_lab.directory, name=own_lab.name, say=print)
    assert own_lab.pis[0].ssh("whoami").stdout == b"pi\n"


def test_down_removes_the_lab_and_nothing_else(lab: Lab, own_lab: Lab) -> None:
    """Containers, volumes, network and files of this lab; not a neighbour's, not a person's file."""
    before = started(lab)
    mine = own_lab.directory / "notes.txt"
    mine.write_text("keep me")
    lifecycle.down(directory=own_lab.directory, name=own_lab.name, say=print)
    label = f"label=fleet.lab={own_lab.name}"
    lists = (("ps", "--all"), ("volume", "ls"), ("network", "ls"))
    assert [docker(*what, "--quiet", "--filter", label) for what in lists] == ["", "", ""]
    assert list(own_lab.directory.iterdir()) == [mine]
    assert started(lab) == before


def test_down_without_a_lab_says_so(tmp_path: Path) -> None:
    """Twice is no error."""
    said: list[str] = []
    lifecycle.down(directory=tmp_path / "nowhere", name=f"{LAB}-none", say=said.append)
    assert said == ["there are no virtual Pis to remove"]


@pytest.fixture
def somebodys_network() -> Iterator[str]:
    """A network with the name a lab would use, made by somebody else."""
    docker("network", "create", f"fleet-{LAB}-taken")
    yield f"{LAB}-taken"
    docker("network", "rm", f"fleet-{LAB}-taken")


def test_somebody_elses_network_is_not_used(tmp_path: Path, somebodys_network: str) -> None:
    """Its containers would meet robots, and down would have to leave it."""
    with pytest.raises(DesktopError, match="does not belong to this lab; remove it"):
        lifecycle.up(1, directory=tmp_path, name=somebodys_network, say=print)


def test_a_pi_with_docker_runs_arm_images_and_restarts_them_after_a_power_cut(own_lab: Lab) -> None:
    """The convenience script, an image for a real Pi, and the container back after the Pi was switched off and on."""
    (pi,) = own_lab.pis
    pi.ssh("cat > get-docker.sh", stdin=GET_DOCKER.read_bytes())
    installed = pi.ssh("sudo sh get-docker.sh")
    assert installed.returncode == 0, installed.stderr.decode()
    assert b"+ sh -c" in installed.stderr
    image = debian_base.ensure("bookworm", "linux/arm64", say=print)
    archive = subprocess.run(("docker", "save", image), capture_output=True, check=True).stdout
    assert pi.ssh("sudo docker load", stdin=archive).returncode == 0
    assert pi.ssh(f"sudo docker run --rm {image} uname -m").stdout == b"aarch64\n"
    run = f"sudo docker run --detach --init --name on --restart unless-stopped {image} sleep 1d"
    assert pi.ssh(run).returncode == 0
    docker("restart", "--time", "0", pi.container)
    assert booted(pi) == "running"
    assert pi.exec("docker", "inspect", "--format", "{{.State.Running}}", "on") == "true"
    assert pi.exec("docker", "compose", "version").startswith("Docker Compose version")


def test_the_stand_in_script_refuses_a_version_there_is_none_of(own_lab: Lab) -> None:
    """As the real one does: exit code 1, before anything is installed."""
    (pi,) = own_lab.pis
    done = pi.ssh("sudo sh -s -- --version 1.2.3", stdin=GET_DOCKER.read_bytes())
    assert (done.returncode, b"'1.2.3' not found amongst" in done.stderr) == (1, True)
    assert pi.ssh("command -v docker").returncode == 1


def test_the_stand_in_script_shows_what_it_would_do(pi: Pi) -> None:
    """--dry-run prints the commands, as any user, and runs none."""
    done = pi.ssh("sh -s -- --dry-run", stdin=GET_DOCKER.read_bytes())
    assert (
        b"apt-get -y -qq install --no-install-recommends docker.io docker-cli docker-compose" in done.stdout
    )
    assert pi.ssh("command -v docker").returncode == 1


def test_a_pi_reboots_when_told_to(own_lab: Lab) -> None:
    """`sudo reboot` brings the same Pi back, with the same host key."""
    (pi,) = own_lab.pis
    key = host_key(pi)
    boot = "cat /proc/1/stat | cut -d' ' -f22"
    before = pi.exec("sh", "-c", boot)
    pi.ssh("sudo reboot")
    script = f'for n in $(seq 100); do now=$(docker exec "$1" sh -c "{boot}" 2>/dev/null); '
    script += '[ "$now" ] && [ "$now" != "$2" ] && exit 0; sleep 0.2; done; exit 1'
    subprocess.run(("sh", "-c", script, "wait", pi.container, before), check=True)
    assert (booted(pi), host_key(pi)) == ("running", key)
