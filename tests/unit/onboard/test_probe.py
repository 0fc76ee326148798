from __future__ import annotations

import getpass
import gzip
import hashlib
import json
import os
import resource
import shutil
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet.diagnosis.packages import PACKAGES
from fleet.images.layer import Blob
from fleet.robot.facts import Dev
from fleet.robot.image_store import ImageStore
from fleet.robot.probe import MARK, command, parse
from tests.support.robot_shell import EACH_SHELL, SHELLS

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.robot.facts import Facts

DIGEST = "1" * 64
GZIP = "application/vnd.oci.image.layer.v1.tar+gzip"
CONFIG = {"mediaType": "application/json", "digest": "sha256:c0", "size": 7}
MANIFEST = json.dumps(
    {"config": CONFIG, "layers": [{"mediaType": GZIP, "digest": digest, "size": 7} for digest in ("x", "y")]}
)


def ran(home: Path, shell: str = "sh", path: str = "") -> subprocess.CompletedProcess[str]:
    """The probe, run on this computer as SSH would run it on a robot."""
    _, *arguments = command(images=True)
    environment = {"HOME": str(home), "PATH": path or os.environ["PATH"]}
    return subprocess.run(
        (*((shell, "sh") if shell == "busybox" else (shell,)), *arguments),
        env=environment,
        cwd=home,
        capture_output=True,
        text=True,
        check=True,
    )


def probed(home: Path, shell: str = "sh", path: str = "") -> str:
    """What the probe says on this computer, but for its Docker."""
    if not path:
        hidden = home.with_name(f"{home.name}-hidden")
        hidden.mkdir(exist_ok=True)
        program(hidden, "docker", "exit 1")
        path = f"{hidden}:{os.environ['PATH']}"
    return ran(home, shell, path).stdout


@pytest.fixture
def bare_path(tmp_path: Path) -> Path:
    """A PATH with the programs of a small system, and neither docker nor sudo; tests add their own."""
    path = tmp_path / "bin"
    path.mkdir()
    for name in (
        "uname",
        "id",
        "date",
        "df",
        "cat",
        "ls",
        "tail",
        "sed",
        "grep",
        "readlink",
        "getent",
        "dpkg",
    ):
        if found := shutil.which(name):
            (path / name).symlink_to(found)
    return path


def program(folder: Path, name: str, script: str) -> None:
    """A program that says what a robot's would."""
    (folder / name).write_text(f"#!/bin/sh\n{script}\n")
    (folder / name).chmod(0o755)


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_the_probe_runs_in_the_shells_of_robots(shell: str, tmp_path: Path) -> None:
    """What it says of this computer is what Python says of it."""
    seen = parse(probed(tmp_path, shell))
    usage = shutil.disk_usage("/var/lib")
    assert seen.host.machine == os.uname().machine
    assert seen.login.name == getpass.getuser()
    assert seen.login.sudo == "root" if os.geteuid() == 0 else seen.login.sudo in ("free", "password", "none")
    assert seen.login.groups
    assert seen.host.memory == os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert abs(seen.host.clock - time.time()) < 60
    assert seen.disk.size == pytest.approx(usage.total, rel=0.1)
    assert seen.host.platforms[0] in ("linux/amd64", "linux/arm64", "linux/arm/v7")
    assert seen.fleet.stacks == {}
    assert seen.fleet.legacy == ""
    assert seen.login.noise == ""


def test_the_probe_sees_what_fleet_keeps_there(tmp_path: Path) -> None:
    """Of each stack: the current release, those that are there (not one that is half written), services, history, data."""
    nav = tmp_path / ".fleet/stacks/nav"
    for name in ("aaa", "bbb", "ccc.part"):
        (nav / "releases" / name).mkdir(parents=True)
    (nav / "releases/bbb/services").write_text("node=always\nmap=no\n")
    (nav / "current").symlink_to("releases/bbb")
    (nav / "journal").write_text("ship bbb\n")
    (nav / "dev").mkdir()
    (nav / "dev/state").write_text("2026-11-28T12:00:00Z tim@desktop\n")
    (nav / "history").write_text("".join(f"line {number}\n" for number in range(300)))
    (nav / "data").mkdir()
    (nav / "data/map").write_bytes(b"x" * 100_000)
    (tmp_path / ".fleet/stacks/cam").mkdir()
    stacks = parse(probed(tmp_path)).fleet.stacks
    assert list(stacks) == ["cam", "nav"]
    assert (stacks["cam"].current, stacks["cam"].releases, stacks["cam"].data) == ("", (), 0)
    seen = stacks["nav"]
    assert (seen.current, seen.releases, seen.services) == ("bbb", ("aaa", "bbb"), ("node", "map"))
    assert seen.journal == "ship bbb"
    assert seen.dev == Dev(by="tim@desktop", since="2026-11-28T12:00:00Z")
    assert len(seen.history) == 200
    assert seen.history[-1] == "line 299"
    assert seen.data
    assert 100_000 <= seen.data < 200_000


@pytest.mark.parametrize("files", [(), ("compose.yaml", "project/a b", "project/Z", "project/é", "services")])
def test_the_checksum_tells_a_release_that_was_edited(tmp_path: Path, files: tuple[str, ...]) -> None:
    """Every file counts; a stack without a current release has none."""
    nav = tmp_path / ".fleet/stacks/nav"
    for name in files:
        (nav / "releases/aaa" / name).parent.mkdir(parents=True, exist_ok=True)
        (nav / "releases/aaa" / name).write_text(name)
    nav.mkdir(parents=True, exist_ok=True)
    (nav / "current").symlink_to("releases/aaa")
    sums = [parse(probed(tmp_path)).fleet.stacks["nav"].checksum]
    for name in files:
        (nav / "releases/aaa" / name).write_text(f"{name}, edited")
        sums.append(parse(probed(tmp_path)).fleet.stacks["nav"].checksum)
    assert len(set(sums)) == len(sums)
    assert all(sums) == bool(files)


def test_the_probe_sees_a_release_of_the_first_version(tmp_path: Path) -> None:
    """Its name is that of the stack which takes it over."""
    old = tmp_path / ".fleet/releases/aaa"
    old.mkdir(parents=True)
    (old / "compose.override.yaml").write_text('{\n  "name": "nav",\n  "services": {\n  "name": "no"\n}}\n')
    (tmp_path / ".fleet/current").symlink_to("releases/aaa")
    assert parse(probed(tmp_path)).fleet.legacy == "nav"
    new = tmp_path / ".fleet/stacks/nav/releases"
    new.mkdir(parents=True)
    old.rename(new / "aaa")  # as far as it came when the power was cut
    assert parse(probed(tmp_path)).fleet.legacy == "nav"
    (tmp_path / ".fleet/current").unlink()
    assert parse(probed(tmp_path)).fleet.legacy == ""


def test_the_probe_looks_and_never_touches(tmp_path: Path) -> None:
    """Not a file, not a time stamp changes in the login's home."""
    (tmp_path / ".fleet/stacks/nav/releases/aaa").mkdir(parents=True)
    (tmp_path / ".fleet/stacks/nav/current").symlink_to("releases/aaa")
    (tmp_path / ".fleet/stacks/nav/history").write_text("one\n")

    def state() -> dict[str, tuple[int, int]]:
        return {str(p): (p.stat().st_mtime_ns, p.stat().st_size) for p in (tmp_path, *tmp_path.rglob("*"))}

    before = state()
    probed(tmp_path)
    assert state() == before


def test_the_probe_is_quick(tmp_path: Path) -> None:
    """`fab status` is one probe: beside Docker it costs less than half a second of a processor."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    costs = []
    for _ in range(3):
        before = spent()
        probed(tmp_path)
        costs.append(spent() - before)
    assert min(costs) < 0.5


def test_a_robot_without_docker_and_sudo(tmp_path: Path, bare_path: Path) -> None:
    """Programs that are not there leave their facts empty; the answer still has its end."""
    said = probed(tmp_path, "/bin/sh", path=str(bare_path))
    seen = parse(said)
    assert f"{MARK} end" in said
    assert (seen.docker.state, seen.docker.version, seen.docker.client, seen.docker.compose) == (
        "absent",
        "",
        "",
        "",
    )
    assert seen.login.sudo in ("root", "none")


@pytest.mark.parametrize(
    ("script", "engine", "version"),
    [
        ("echo 28.0.4", "ready", "28.0.4"),
        ("echo 20.10.24+dfsg1", "ready", "20.10.24+dfsg1"),
        (
            "echo 'WARNING: open /home/pi/.docker/config.json: permission denied' >&2; echo 28.0.4",
            "ready",
            "28.0.4",
        ),
        (
            "echo 'permission denied while trying to connect to the Docker daemon socket' >&2; exit 1",
            "forbidden",
            "",
        ),
        (
            "echo 'Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is it running?' >&2; exit 1",
            "stopped",
            "",
        ),
        ("exit 1", "stopped", ""),
    ],
)
def test_an_engine_is_known_by_what_its_client_says(
    tmp_path: Path, bare_path: Path, script: str, engine: str, version: str
) -> None:
    """The client writes its reasons to standard error, and warnings before its answer."""
    program(bare_path, "docker", f'[ "$1" = version ] || exit 1\n{script}')
    seen = parse(probed(tmp_path, "/bin/sh", path=str(bare_path)))
    assert (seen.docker.state, seen.docker.version) == (engine, version)


# What podman-docker 4.3 (Debian 12) answers: the version alone is that of an engine that is ready.
SHIM = """case "$1$2" in
    --version*) echo 'podman version 4.3.1' ;;
    version*) case "$*" in *Components*) echo "Error: template: version:1:28: can't evaluate field Components" >&2; exit 125 ;;
        *) echo 4.3.1 ;; esac ;;
    *) exit 125 ;;
esac"""


def docker(answer: str, *, client: str = "Docker version 28.2.2, build e6534b4", info: str = "") -> str:
    """A `docker` command that answers so."""
    return f"""case "$1" in
    --version) echo '{client}' ;;
    version) echo '{answer}' ;;
    info) printf '%s\\n' '{info}' ;;
    *) exit 1 ;;
esac"""


DOCKER = docker(
    "28.2.2 Engine containerd runc docker-init",
    info="/var/lib/docker overlay2 extfs true\nname=seccomp,profile=builtin\nname=cgroupns\n",
)
NOBODY_ANSWERS = (
    "Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is the docker daemon running?"
)
ROOTLESS_STOPPED = NOBODY_ANSWERS.replace("/var/run/", "/run/user/1000/")


@pytest.mark.parametrize(
    ("script", "kind", "state"),
    [
        (DOCKER, "docker", "ready"),
        (docker(NOBODY_ANSWERS), "docker", "stopped"),
        (SHIM, "podman", "stopped"),
        # A link from docker to podman, which takes its name.
        (docker("4.9.3", client="docker version 4.9.3"), "podman", "ready"),
        # Docker's own client on podman's socket, podman 4.3.
        (
            docker(
                "4.3.1 Podman Engine Conmon OCI Runtime (crun) Engine",
                info="/var/lib/containers/storage overlay",
            ),
            "podman",
            "ready",
        ),
        (
            docker(
                "28.2.2 Engine containerd runc docker-init rootlesskit",
                info="/home/pi/.local/share/docker overlay2\nname=seccomp,profile=builtin\nname=rootless\nname=cgroupns\n",
            ),
            "rootless",
            "ready",
        ),
        (docker(ROOTLESS_STOPPED), "rootless", "stopped"),
        (
            docker("28.1.1 Engine", info="/var/snap/docker/common/var-lib-docker overlay2\nname=apparmor\n"),
            "snap",
            "ready",
        ),
    ],
)
def test_an_engine_that_is_not_docker_is_known_for_what_it_is(
    tmp_path: Path, bare_path: Path, script: str, kind: str, state: str
) -> None:
    """`docker` is a name that several engines have."""
    for name in ("head", "tail"):
        if not (bare_path / name).exists():
            (bare_path / name).symlink_to(shutil.which(name) or "")
    program(bare_path, "docker", script)
    seen = parse(probed(tmp_path, "/bin/sh", path=str(bare_path))).docker
    assert (seen.kind, seen.state) == (kind, state)


def test_a_rootless_docker_outside_the_path_is_seen(tmp_path: Path, bare_path: Path) -> None:
    """Its installer writes a service of the user, and its programs to ~/bin."""
    assert parse(probed(tmp_path, "/bin/sh", path=str(bare_path))).docker.kind == ""
    service = tmp_path / ".config/systemd/user/docker.service"
    service.parent.mkdir(parents=True)
    service.touch()
    assert parse(probed(tmp_path, "/bin/sh", path=str(bare_path))).docker.kind == "rootless"
    program(bare_path, "docker", DOCKER)
    assert parse(probed(tmp_path, "/bin/sh", path=str(bare_path))).docker.kind == "docker"


def test_commands_that_are_missing_are_named(tmp_path: Path, bare_path: Path) -> None:
    """Before a script fails without them, with words about something else."""
    everything = parse(probed(tmp_path)).host.missing
    assert everything == ()
    missing = parse(probed(tmp_path, "/bin/sh", path=str(bare_path))).host.missing
    assert {"flock", "sha256sum", "env", "find", "awk"} <= set(missing)
    assert not {"cat", "date", "id", "sed"} & set(missing)
    assert set(missing) <= set(PACKAGES)


@pytest.mark.skipif("busybox" not in SHELLS, reason="needs busybox")
def test_busyboxs_own_commands_are_not_enough(tmp_path: Path) -> None:
    """Its env has no -C, its flock no --wait."""
    path = tmp_path / "bin"
    path.mkdir()
    busybox = shutil.which("busybox") or ""
    for name in subprocess.run(
        (busybox, "--list"), capture_output=True, text=True, check=True
    ).stdout.split():
        (path / name).symlink_to(busybox)
    assert {"env", "flock"} <= set(parse(probed(tmp_path, str(path / "sh"), path=str(path))).host.missing)


def test_a_home_that_is_not_the_logins_own_is_seen(tmp_path: Path) -> None:
    """One that belongs to root, such as after `sudo useradd`, and one that was never made."""
    assert parse(probed(tmp_path)).login.home_state == "own"
    other = 65534 if os.geteuid() == 0 else None
    states = {}
    for home in ("/usr", "/nosuch"):
        done = subprocess.run(
            command(),
            env={"HOME": home, "PATH": "/usr/bin:/bin"},
            cwd="/",
            user=other,
            capture_output=True,
            text=True,
            check=True,
        )
        states[home] = parse(done.stdout).login.home_state
    assert states == {"/usr": "foreign", "/nosuch": "missing"}


@pytest.fixture
def quoted_home(tmp_path: Path) -> Path:
    """A login's home, its name one that has to be quoted."""
    path = tmp_path / "home of pi"
    path.mkdir()
    return path


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """Programs of a robot: a Docker with one image, and the tools."""
    path = tmp_path / "bin"
    path.mkdir()
    image = f"sha256:{hashlib.sha256(MANIFEST.encode()).hexdigest()}"
    docker = f"""case "$*" in
        'image ls'*)
            echo talker:fleet-1 {image} 241MB && echo talker:fleet-0123456789ab {image} 241MB
            echo fleet/incoming:0123 {image} 241MB ;;
        *json*' {image}') echo '{image} ["a","b"]' ;;
        esac"""
    for name, script in (("docker", docker), ("zstd", ""), ("python3", "")):
        (path / name).write_text(f"#!/bin/sh\n{script}\n")
        (path / name).chmod(0o755)
    return path


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_the_probe_of_a_robot_that_was_shipped_to(shell: str, quoted_home: Path, programs: Path) -> None:
    """What lies in its home comes out as a value: receipts, pieces, pins, and beside them images and tools."""
    files = {
        "receipts/0123456789ab": MANIFEST,
        "receipts/ba9876543210": "{}",
        "pulled/0123456789ab": MANIFEST,
        "pulled/references": "a line that is no manifest",
        "pulled/0123456789ab.new": MANIFEST,
        f"spool/{DIGEST}": "12345",
        "spool/lock": "",
        "spool/holder": "1 token receive tim@desktop",
        "stacks/nav/releases/abc/compose.yaml": '{"services": {\n  "a": {\n    "image": "talker:fleet-1",\n}}}\n',
        "releases/old/compose.override.yaml": '{"services": {\n  "a": {\n    "image": "talker:fleet-0",\n}}}\n',
        "releases/old/compose.yaml": "services:\n  a:\n    image: talker\n",
    }
    for name, text in files.items():
        (quoted_home / ".fleet" / name).parent.mkdir(parents=True, exist_ok=True)
        (quoted_home / ".fleet" / name).write_text(text)
    done = ran(quoted_home, shell, path=f"{programs}:{os.environ['PATH']}")
    assert done.stderr == ""
    seen = parse(done.stdout)
    blobs = (Blob(diff_id=d, digest=b, size=7, media_type=GZIP) for d, b in (("a", "x"), ("b", "y")))
    assert seen.fleet.image_store == ImageStore(
        chains=(("a", "b"),),
        manifests=(tuple(blobs),),
        spool={DIGEST: 5},
        pins={"nav/abc": ("talker:fleet-1",), "/old": ("talker:fleet-0",)},
        sizes={"talker:fleet-1": 241_000_000, "talker:fleet-0123456789ab": 241_000_000},
        leftovers=("fleet/incoming:0123",),
        zstd=True,
        python=True,
    )
    name = f"sha256:{hashlib.sha256(MANIFEST.encode()).hexdigest()}"
    assert seen.fleet.images == {"talker:fleet-1": name, "talker:fleet-0123456789ab": "sha256:c0"}


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_the_probe_of_a_robot_that_was_never_shipped_to(shell: str, quoted_home: Path) -> None:
    """There is nothing, nothing is made, and nothing is complained about; Docker itself is the desktop's."""
    done = ran(quoted_home, shell)
    assert done.stderr == ""
    images = parse(done.stdout).fleet.image_store
    assert (images.manifests, images.spool, images.pins) == ((), {}, {})
    assert list(quoted_home.iterdir()) == []


def test_the_sections_about_images_come_only_when_asked_for(tmp_path: Path) -> None:
    """They take longer, and most verbs do without."""
    environment = {"HOME": str(tmp_path), "PATH": os.environ["PATH"]}
    short = subprocess.run(command(), env=environment, capture_output=True, text=True, check=True).stdout
    assert f"{MARK} tools" in probed(tmp_path)
    assert f"{MARK} tools" not in short
    assert short.endswith(f"{MARK} end\n")


ROOTS = (
    "/etc/nv_tegra_release",
    "/etc/cdi",
    "/etc/udev",
    "/proc/device-tree",
    "/proc/config.gz",
    "/boot/firmware",
    "/run/fleet",
)
CDI_YAML = """\
---
cdiVersion: 0.5.0
containerEdits:
  hooks:
  - args: [nvidia-cdi-hook, name, kind]
    hookName: createContainer
devices:
- containerEdits:
    deviceNodes:
    - path: /dev/nvhost-gpu
  name: "0"
- containerEdits: {}
  name: all
kind: nvidia.com/gpu
"""
CDI_JSON = json.dumps(
    {"cdiVersion": "0.6.0", "kind": "vendor.com/arm", "devices": [{"name": "left"}]}, indent=4
)


def seen_below(root: Path, path: Path, *, images: bool = False) -> Facts:
    """The probe, run with some files of a system that is below ``root``."""
    _, flag, script, *arguments = command(images=images)
    for place in ROOTS:
        assert place in script
        script = script.replace(place, f"{root}{place}")
    script = script.replace("PATH=$PATH:/usr/sbin:/sbin", "")
    environment = {"HOME": str(root), "PATH": str(path)}
    argv = ("/bin/sh", flag, script, *arguments)
    return parse(subprocess.run(argv, env=environment, capture_output=True, text=True, check=True).stdout)


@pytest.fixture
def tools(bare_path: Path) -> Path:
    """A PATH with what the probe needs to look at hardware."""
    for name in ("cut", "find", "head", "sh", "tr", "zcat", "gzip"):
        if not (bare_path / name).exists():
            (bare_path / name).symlink_to(shutil.which(name) or "")
    return bare_path


def file(root: Path, name: str, text: str) -> None:
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(text)


def test_a_jetson_is_seen(tmp_path: Path, tools: Path) -> None:
    """Its board, its Linux, the table that its kernel lacks, and the devices of CDI specifications in both forms."""
    file(
        tmp_path,
        "etc/nv_tegra_release",
        "# R36 (release), REVISION: 4.0, GCID: 37537400, BOARD: generic\n# more\n",
    )
    file(tmp_path, "proc/device-tree/model", "NVIDIA Jetson Orin Nano Developer Kit\0")
    file(tmp_path, "etc/cdi/nvidia.yaml", CDI_YAML)
    file(tmp_path, "etc/cdi/arm.json", CDI_JSON)
    file(tmp_path, "etc/cdi/notes.txt", "kind: a/b\nname: c\n")
    (tmp_path / "proc/config.gz").write_bytes(gzip.compress(b"# CONFIG_IP_NF_RAW is not set\n"))
    program(tools, "iptables", "echo 'iptables v1.8.7 (nf_tables)'")
    program(tools, "modprobe", "exit 1")
    program(tools, "nvidia-ctk", "exit 0")
    seen = seen_below(tmp_path, tools).hardware
    assert (seen.model, seen.l4t) == ("NVIDIA Jetson Orin Nano Developer Kit", "36.4.0")
    assert (seen.toolkit, seen.raw_table) == (True, False)
    assert set(seen.cdi) == {"nvidia.com/gpu=0", "nvidia.com/gpu=all", "vendor.com/arm=left"}


@pytest.mark.parametrize(
    ("modprobe", "config", "iptables", "raw"),
    [
        ("exit 0", "", "legacy", True),
        ("exit 1", "CONFIG_IP_NF_RAW=y", "legacy", True),
        ("exit 1", "CONFIG_IP_NF_RAW=m", "legacy", False),
        ("exit 1", "# CONFIG_IP_NF_RAW is not set", "legacy", False),
        ("exit 1", "# CONFIG_IP_NF_RAW is not set", "nf_tables", True),
    ],
)
def test_the_raw_table_of_the_kernel(
    tmp_path: Path, tools: Path, modprobe: str, config: str, iptables: str, raw: bool
) -> None:
    """Built in, a module that is there, or nothing; iptables over nf_tables needs none."""
    file(tmp_path, "proc/config.gz", "")
    (tmp_path / "proc/config.gz").write_bytes(gzip.compress(f"{config}\n".encode()))
    program(tools, "iptables", f"echo 'iptables v1.8.7 ({iptables})'")
    program(tools, "modprobe", modprobe)
    assert seen_below(tmp_path, tools).hardware.raw_table == raw


def test_a_raspberry_pi_is_seen(tmp_path: Path, tools: Path) -> None:
    """The lines of config.txt that count, also from a file with line ends of Windows; names that udev gives; what waits."""
    file(tmp_path, "proc/device-tree/model", "Raspberry Pi 4 Model B Rev 1.4\0")
    file(tmp_path, "boot/firmware/config.txt", "dtparam=i2c_arm=on\r\n#dtparam=spi=on\r\nenable_uart=1\r\n")
    file(tmp_path, "boot/firmware/cmdline.txt", "console=tty1 root=PARTUUID=1\n")
    file(tmp_path, "etc/udev/rules.d/99-fleet.rules", 'KERNELS=="1-1", SYMLINK+="null"\n')
    file(tmp_path, "run/fleet-reboot", " i2c\n serial\n")
    program(tools, "raspi-config", "exit 0")
    seen = seen_below(tmp_path, tools).hardware
    assert seen.model == "Raspberry Pi 4 Model B Rev 1.4"
    assert seen.raspi_config
    assert (seen.interfaces, seen.reboot_for) == (("i2c", "serial"), ("i2c", "serial"))
    assert seen.udev_rules == 'KERNELS=="1-1", SYMLINK+="null"'
    assert "/dev/null" in seen.devices
    assert "root" in seen.system_groups


def test_the_kernels_parameters_of_ubuntu(tmp_path: Path, tools: Path) -> None:
    """Since 25.10 they are in a folder, and a file beside it counts no more: here a console has the serial port."""
    file(tmp_path, "boot/firmware/config.txt", "enable_uart=1\n")
    file(tmp_path, "boot/firmware/cmdline.txt", "console=tty1\n")
    assert seen_below(tmp_path, tools).hardware.interfaces == ("serial",)
    file(tmp_path, "boot/firmware/current/cmdline.txt", "console=serial0,115200 console=tty1\n")
    assert seen_below(tmp_path, tools).hardware.interfaces == ()


def test_for_a_release_all_devices_are_listed(tmp_path: Path, tools: Path) -> None:
    """A Compose file may name any; folders too."""
    few, all_of_them = (
        set(seen_below(tmp_path, tools, images=images).hardware.devices) for images in (False, True)
    )
    assert {"/dev/null", "/dev/zero", "/dev/pts"} <= all_of_them
    assert "/dev/zero" not in few
