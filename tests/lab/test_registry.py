"""Three ways to one release: over SSH, pulled through SSH, and pulled from a registry with TLS and client certificates."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING

import pytest

from tests.support.lab_project import (
    Project,
    cut,
    eventually,
    forget,
    on_each,
    prove,
    running,
    tags,
    wipe,
)
from tests.support.registry import make_certificates

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi

PROGRAM = Path.home() / ".cache/fleet/bench-registry/usr/bin/docker-registry"
IMAGE = "fleettest-pulled"
SIZE = 4_000_000
STACK = f"""\
name: tiny
services:
  tick:
    image: {IMAGE}
    build: .
    environment: [COLOUR]
    healthcheck: {{test: [CMD, /bin/busybox, "true"], interval: 5s, start_period: 20s, start_interval: 100ms}}
    stop_signal: SIGKILL
"""
DOCKERFILE = """\
FROM scratch
COPY busybox /bin/busybox
COPY payload /payload
COPY code /code
CMD ["/bin/busybox", "sh", "-c", "while sleep 1; do cat /code; done"]
"""


@dataclass(kw_only=True)
class Site:
    """A registry that only those can use who have a certificate."""

    address: str
    folder: Path
    process: subprocess.Popen[bytes] | None = None

    def start(self, config: Path | None = None) -> None:
        log: IO[bytes] = (self.folder / "log").open("ab")
        with log:
            environment = {**os.environ, "OTEL_TRACES_EXPORTER": "none"}
            argv = (_program(), "serve", str(config or self.folder / "config.yml"))
            self.process = subprocess.Popen(argv, env=environment, stdout=log, stderr=log)
        host, _, port = self.address.partition(":")
        assert eventually(lambda: _listens(host, int(port))), (self.folder / "log").read_text()

    @contextlib.contextmanager
    def on_loopback(self) -> Iterator[str]:
        """The same images without TLS, at an address that Docker takes without it."""
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            address = f"127.0.0.1:{free.getsockname()[1]}"
        config = json.loads((self.folder / "config.yml").read_text())
        path = self.folder / "loopback.yml"
        path.write_text(json.dumps({**config, "http": {"addr": address}}))
        other = Site(address=address, folder=self.folder)
        other.start(path)
        try:
            yield address
        finally:
            other.stop()

    def stop(self) -> None:
        if self.process:
            self.process.kill()
            self.process.wait()


def _program() -> str:
    return shutil.which("docker-registry") or str(PROGRAM)


def _listens(host: str, port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex((host, port)) == 0


@pytest.fixture(scope="module")
def site(provisioned: Lab, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Debian's, unpacked where it is not installed: the package would start one at once."""
    if not Path(_program()).exists():
        PROGRAM.parents[2].mkdir(parents=True, exist_ok=True)
        script = (
            "apt-get -q download docker-registry && dpkg-deb --extract docker-registry_*.deb . && rm *.deb"
        )
        done = subprocess.run(("sh", "-c", script), cwd=PROGRAM.parents[2], capture_output=True, check=False)
        if done.returncode:
            pytest.skip("no docker-registry from Debian")
    gateway = provisioned.pis[0].exec("sh", "-c", "ip route | sed -n 's/^default via \\([^ ]*\\).*/\\1/p'")
    folder = tmp_path_factory.mktemp("registry")
    make_certificates(folder, "server", "client", address=gateway)
    with socket.socket() as free:
        free.bind((gateway, 0))
        address = f"{gateway}:{free.getsockname()[1]}"
    tls = {"certificate": str(folder / "server.crt"), "key": str(folder / "server.key")}
    config = {
        "version": 0.1,
        "log": {"level": "error", "accesslog": {"disabled": True}},
        "storage": {"filesystem": {"rootdirectory": str(folder / "data")}},
        "http": {"addr": address, "tls": {**tls, "clientcas": [str(folder / "ca.crt")]}},
    }
    (folder / "config.yml").write_text(json.dumps(config))
    one = Site(address=address, folder=folder)
    one.start()
    yield one
    one.stop()


@pytest.fixture(scope="module")
def fleet(provisioned: Lab, site: Site, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Project]:
    """Three robots, of linux/amd64 as they are, each with a way of its own, by which the first release has come."""
    on_each(provisioned.pis, wipe)
    project = Project.made(tmp_path_factory.mktemp("pulled"), provisioned)
    for name, text in (("compose.yaml", STACK), ("Dockerfile", DOCKERFILE)):
        project.write(f"docker/{name}", text)
    shutil.copy("/bin/busybox", project.directory / "docker/busybox")
    (project.directory / "docker/payload").write_bytes(os.urandom(SIZE))
    ways(project, site)
    code(project, "first")
    last = provisioned.pis[2].name
    refused = project.fab("ship", "--hosts", last)
    assert (refused.code, f"does not know the registry {site.address} yet" in refused.out) == (1, True)
    project.well("provision", "--hosts", last)
    project.well("ship")
    yield project
    forget(IMAGE)
    script = f"docker ps -aq | xargs -r docker rm -f; docker image ls -q {IMAGE} | sort -u | xargs -r docker image rm -f"
    on_each(
        provisioned.pis,
        lambda pi: pi.exec("sh", "-c", f"{script}; rm -rf ~pi/.fleet /etc/docker/certs.d"),
    )


def ways(project: Project, site: Site) -> None:
    """The inventory: nothing for the first robot, the last one with a registry."""
    files = {"ca": "ca.crt", "client_cert": "client.crt", "client_key": "client.key"}
    own = {key: str(site.folder / name) for key, name in files.items()}
    _, tunnelled, tls = (pi.name for pi in project.lab.pis)
    project.inventory(
        all_={"robots": ["*"], "platform": "linux/amd64", "environment": {"COLOUR": "red"}},
        pulls={"robots": [tunnelled, tls], "transport": "registry"},
        site={"robots": [tls], "registry": {"address": f"{site.address}/robots", **own}},
    )


def code(project: Project, text: str) -> None:
    """Change one line of the program."""
    project.write("docker/code", text)
    project.well("build")


def came(project: Project) -> dict[str, tuple[str, str]]:
    """The current release of each robot, and how it came, as `fab status` says."""
    seen = project.well("status", "--json").json
    return {
        name: (one["fleet"]["stacks"]["tiny"]["current"], one["fleet"]["stacks"]["tiny"]["came"])
        for name, one in seen.items()
    }


def names(pi: Pi) -> str:
    """Every name and digest by which Docker knows an image."""
    return pi.exec(
        "docker", "image", "ls", "--all", "--digests", "--format", "{{.Repository}}:{{.Tag}}@{{.Digest}}"
    )


def test_one_release_by_three_ways(fleet: Project, site: Site) -> None:
    """All run the same, `fab status` says how it came, and one changed line costs each of them under 100 kB."""
    _, tunnelled, tls = fleet.lab.pis
    assert fleet.well("provision", "--hosts", tls.name, "--json").status == {tls.name: "unchanged"}
    modes = tls.exec("sh", "-c", "stat -c '%a %U' /etc/docker/certs.d/*/*").splitlines()
    assert modes == ["600 root"] * 3
    before = tags(tls)
    code(fleet, "second")
    assert fleet.well("ship", "--dry").out.count("lacks 1 of 3 layers, pulls ") == 2
    shipped = fleet.well("ship", "--json")
    assert set(shipped.status.values()) == {"done"}
    assert all(one["sent"] < 100_000 for one in shipped.json), shipped.out
    assert f"from the registry {site.address}" in shipped.json[2]["transfer"]
    seen = came(fleet)
    assert len({release for release, _ in seen.values()}) == 1
    assert [way for _, way in seen.values()] == [
        *("ssh", "registry through SSH", f"registry {site.address}"),
    ]
    images = {
        pi.exec("docker", "inspect", "-f", "{{.Image}}", running(pi)["tick"][0]) for pi in fleet.lab.pis
    }
    assert len(images) == 1
    for pi in (tunnelled, tls):
        prove(pi)
        assert "127.0.0.1" not in names(pi)
        assert site.address not in names(pi)
        assert len(tags(pi)) == len(before) + 1
    assert fleet.well("rollback", "--hosts", tls.name, "--json").status == {tls.name: "done"}


def test_what_goes_wrong_leaves_the_old_release(fleet: Project, site: Site) -> None:
    """A registry that is down, an sshd that forwards nothing; a link that is cut in the middle of a pull is taken up again."""
    _, tunnelled, tls = fleet.lab.pis
    (fleet.directory / "docker/payload").write_bytes(os.urandom(SIZE))
    code(fleet, "third")
    site.stop()
    tunnelled.exec(
        "sh", "-c", "echo 'AllowTcpForwarding no' >/etc/ssh/sshd_config.d/00.conf; systemctl reload ssh"
    )
    try:
        failed = fleet.fab("ship", "--hosts", f"{tunnelled.name},{tls.name}")
    finally:
        tunnelled.exec("sh", "-c", "rm /etc/ssh/sshd_config.d/00.conf; systemctl reload ssh")
        site.start()
    assert failed.code == 1
    assert "its sshd forwards no ports" in failed.out
    assert f"the registry {site.address} cannot be reached" in failed.out
    assert all(len(running(pi)) == 1 for pi in (tunnelled, tls))
    with fleet.start("ship", "--hosts", tunnelled.name, "--limit", "8Mbit", "--json") as ship:
        with cut(tunnelled, after=2_000_000) as happened:
            assert eventually(happened, within=60)
        assert ship.end(within=180).status == {tunnelled.name: "done"}
    prove(tunnelled)
    assert "127.0.0.1" not in names(tunnelled)


def test_others_pull_what_was_pushed(fleet: Project, site: Site) -> None:
    """By the name and digest that `fab push` prints."""
    tls = fleet.lab.pis[2]
    (pushed,) = fleet.well("push", "--json").json
    assert pushed["image"].startswith(f"{site.address}/robots/{IMAGE}:latest@sha256:")
    assert fleet.well("push", "--json").json == [{**pushed, "bytes": 0}]
    tls.exec("docker", "pull", "--quiet", pushed["image"])
    tls.exec("docker", "image", "rm", pushed["image"])


def test_what_ci_has_pushed_is_shipped(fleet: Project, site: Site) -> None:
    """By its digest, onto a computer that has not built it: all robots run one release, whichever way it came."""
    plain, _, tls = fleet.lab.pis
    code(fleet, "pushed")
    (pushed,) = fleet.well("push", "--json").json
    fleet.well("ship", "--hosts", tls.name)
    forget(IMAGE)
    with site.on_loopback() as address:
        name = pushed["image"].replace(site.address, address)
        refused = fleet.fab("ship", "--hosts", plain.name, "--from", name, "--dry")
        assert (refused.code, "is not on this computer" in refused.err) == (2, True), refused
        lost = fleet.fab("ship", "--hosts", plain.name, "--from", name[:-4] + "0000")
        assert (lost.code, "docker pull" in lost.err or "pull" in lost.err) == (1, True), lost
        shipped = fleet.well("ship", "--hosts", plain.name, "--from", name, "--json")
        assert shipped.status == {plain.name: "done"}
        again = fleet.well("ship", "--hosts", f"{plain.name},{tls.name}", "--from", name, "--json")
    assert set(again.status.values()) == {"unchanged"}
    seen = came(fleet)
    assert seen[plain.name] == (seen[tls.name][0], "ssh")
    prove(plain)
    subprocess.run(("docker", "image", "rm", name.replace(":latest@", "@")), capture_output=True, check=True)
