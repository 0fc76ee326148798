from __future__ import annotations

import hashlib
import io
import json
import shlex
import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.onboard import exit_codes
from fleet.transfer import rebuild_command
from tests.support.layers import made, noise, tar

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi

IMAGE = "fleettest-rebuild:1"

LOWER = tar({"etc/name": b"lower"})
OLD = tar({f"usr/lib/{number}": noise(number, 50_000) for number in range(20)})
NEW = tar({f"usr/lib/{number}": noise(number, 50_000) for number in range(1, 20)}, time=7.25)


def digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def archive() -> bytes:
    """What `docker load` reads: an image of two layers."""
    diff_ids = [digest(LOWER), digest(OLD)]
    config = {"os": "linux", "architecture": "amd64", "rootfs": {"type": "layers", "diff_ids": diff_ids}}
    manifest = [{"Config": "config", "RepoTags": [IMAGE], "Layers": ["lower", "old"]}]
    return tar(
        {
            "config": json.dumps(config).encode(),
            "lower": LOWER,
            "old": OLD,
            "manifest.json": json.dumps(manifest).encode(),
        }
    )


def arguments(info: str, place: str) -> Iterator[tuple[str, ...]]:
    """The command lines that check and write the new layer, and that write the old one, on an engine with that store."""
    driver, root = info.split()
    chain = digest(f"{digest(LOWER)} {digest(OLD)}".encode())
    classic = driver == "overlay2"
    old = (
        rebuild_command.from_chain(chain, root=root)
        if classic
        else rebuild_command.from_blob(digest(OLD), root=root)
    )
    program, patch = f"{place}/rebuild.py", f"{place}/patch"
    for check in (True, False):
        yield rebuild_command.argv(program, old, wanted=digest(NEW), patch=patch, scratch=place, check=check)
    yield rebuild_command.argv(program, old, wanted=digest(OLD), scratch=place)


INFO = ("docker", "info", "--format", "{{.Driver}} {{.DockerRootDir}}")


@pytest.mark.usefixtures("provisioned")
def test_a_layer_of_a_pis_own_engine_becomes_a_new_one(pi: Pi) -> None:
    """As a person's login with sudo; without, it says that the right is missing."""

    def ssh(*argv: str, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
        return pi.ssh(shlex.join(argv), stdin=stdin)

    place = "/home/pi/rebuild"
    try:
        assert ssh("docker", "load", stdin=archive()).returncode == 0
        assert ssh("mkdir", place).returncode == 0
        for name, data in (("rebuild.py", rebuild_command.program()), ("patch", made(OLD, NEW))):
            assert ssh("tee", f"{place}/{name}", stdin=data).returncode == 0
        check, write, copy = arguments(ssh(*INFO).stdout.decode(), place)
        assert ssh("sudo", "-n", *check).stdout == b""
        assert ssh("sudo", "-n", *check).returncode == 0
        assert ssh("sudo", "-n", *write).stdout == NEW
        assert ssh("sudo", "-n", *copy).stdout == OLD
        refused = ssh(*write)
        assert (refused.returncode, refused.stdout) == (exit_codes.MISSING, b"")
        assert refused.stderr.endswith(b": Permission denied\n")
        assert sorted(ssh("ls", "-A", place).stdout.split()) == [b"patch", b"rebuild.py"]
    finally:
        ssh("docker", "image", "rm", IMAGE)
        ssh("rm", "-r", place)


def test_a_layer_of_this_computers_engine_becomes_a_new_one(lab: Lab) -> None:
    """Whichever engine and store that is; a container of the lab's image is root enough to read it."""
    root = subprocess.run(INFO, capture_output=True, text=True, check=True).stdout
    about = ("docker", "inspect", "--format", "{{.Image}}", lab.pis[0].container)
    image = subprocess.run(about, capture_output=True, text=True, check=True).stdout.strip()
    subprocess.run(("docker", "load"), input=archive(), capture_output=True, check=True)
    stores = {root.split()[1], "/var/lib/containerd"}
    volumes = (part for store in stores for part in ("--volume", f"{store}:{store}:ro"))
    files = io.BytesIO(tar({"rebuild.py": rebuild_command.program(), "patch": made(OLD, NEW)}))
    container = (
        "docker",
        "create",
        "--interactive",
        *volumes,
        "--entrypoint",
        "sh",
        image,
        "-c",
        "sleep 300",
    )
    name = subprocess.run(container, capture_output=True, text=True, check=True).stdout.strip()
    try:
        subprocess.run(("docker", "cp", "-", f"{name}:/srv"), input=files.getvalue(), check=True)
        subprocess.run(("docker", "start", name), capture_output=True, check=True)
        check, write, copy = (
            subprocess.run(("docker", "exec", name, *argv), capture_output=True, check=True).stdout
            for argv in arguments(root, "/srv")
        )
        assert (check, write, copy) == (b"", NEW, OLD)
    finally:
        subprocess.run(("docker", "rm", "--force", "--volumes", name), capture_output=True, check=False)
        subprocess.run(("docker", "image", "rm", IMAGE), capture_output=True, check=True)
