"""The talker's image, as built: platforms and size, a real roscore, health, end, and bad days."""

from __future__ import annotations

import ipaddress
import itertools
import json
import shutil
import subprocess
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import pytest

from fleet.config.inventory import Robot
from fleet.errors import DesktopError, NotAsPlanned, RobotError, TimedOut
from fleet.images import debian_base
from fleet.images.docker_cli import buildkit_client, docker
from fleet.images.emulation import desktop_platform, emulates
from fleet.ros import listen
from tests.support import debian_archive as debianarchive
from tests.support.lab_project import LAB, eventually, forget

if TYPE_CHECKING:
    from collections.abc import Iterator

PROJECT = Path(__file__).parents[2]
NAME = f"{LAB}-talker"
HEALTH = ("python3", "-IS", "/usr/local/lib/fleet/tcpros.py", "time", "--timeout", "2")
# What an ELF file calls a processor: bytes 18 and 19 of it.
MACHINES = {"linux/arm64": 183, "linux/arm/v7": 40, "linux/amd64": 62}


class Start(Protocol):
    """Starts an image as a robot does, but on a network of the tests' own; gives the robot."""

    def __call__(self, image: str, *options: str, hostname: str = "") -> Robot: ...


def build(tag: str, platform: str, *options: str, context: Path = PROJECT) -> str:
    """Build the project's Dockerfile, without a registry; give the image's name."""
    bases = {"BUILD_BASE": desktop_platform(), "RUN_BASE": platform}
    arguments = [
        f"--build-arg={name}={debian_base.ensure('bookworm', of, say=print)}" for name, of in bases.items()
    ]
    image = f"{NAME}:{tag}"
    command = (*buildkit_client(), "build", "--platform", platform, "--tag", image, *arguments, *options)
    where = ("--file", str(context / "docker/Dockerfile"), str(context))
    done = subprocess.run((*command, *where), capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return image


def inspect(what: str, template: str) -> str:
    return docker("inspect", "--format", template, what)


def inside(*argv: str) -> subprocess.CompletedProcess[str]:
    """Run a command in the running container."""
    command = ("docker", "exec", NAME, *argv)
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def first_message(robot: Robot, *, within: float) -> str:
    """The first message of a robot that is just starting, or the last reason why none came."""
    end = time.monotonic() + within
    while True:
        try:
            with closing(listen.messages(robot, "time", timeout=10)) as arriving:
                return next(arriving).text()
        except RobotError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)


def wait_for(template: str, answer: str, *, within: float) -> None:
    """Wait until Docker says something of the container."""
    end = time.monotonic() + within
    while inspect(NAME, template) != answer:
        assert time.monotonic() < end, f"{template} is {inspect(NAME, template)}, not {answer}"
        time.sleep(0.2)


@pytest.fixture(scope="module", autouse=True)
def _nothing_left_behind() -> Iterator[None]:
    yield
    forget(NAME)


@pytest.fixture(scope="module")
def image() -> str:
    """The talker for this computer's own platform."""
    return build("native", desktop_platform())


def network() -> str:
    """Make it; its subnet, or "" if somebody else was handed the same one meanwhile."""
    docker("network", "create", NAME)
    subnet = json.loads(docker("network", "inspect", NAME))[0]["IPAM"]["Config"][0]["Subnet"]
    # Docker has found a free subnet; only one that was asked for has addresses to choose from.
    docker("network", "rm", NAME)
    try:
        docker("network", "create", "--subnet", subnet, NAME)
    except DesktopError:
        return ""
    return str(subnet)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """An address on a network of the tests' own, which this computer reaches as it would a robot's."""
    subnet = eventually(network)
    yield str(ipaddress.ip_network(subnet)[10])
    docker("network", "rm", NAME)


@pytest.fixture
def start(address: str) -> Iterator[Start]:
    def start(image: str, *options: str, hostname: str = "") -> Robot:
        ros = f"ROS_HOSTNAME={hostname or address}"
        where = ("--network", NAME, "--ip", address, "--env", ros, "--restart", "unless-stopped")
        docker("run", "--detach", "--name", NAME, *where, *options, image)
        return Robot.model_validate(
            {"name": "pi1", "address": address, "ros": {"hostname": hostname or None}}
        )

    yield start
    # For whoever reads a failed test.
    print(subprocess.run(("docker", "logs", NAME), capture_output=True, text=True, check=False))  # noqa: T201
    docker("rm", "--force", NAME)


@pytest.mark.parametrize("platform", MACHINES)
def test_image_is_for_its_platform_and_small(platform: str) -> None:
    """Recorded platform and the programs inside agree; 260 MB is the most a robot has to take."""
    debianarchive.base(platform)
    image = build(platform.replace("/", "-"), platform)
    recorded = inspect(image, "{{.Os}}/{{.Architecture}}/{{.Variant}}").rstrip("/").removesuffix("/v8")
    assert recorded == platform
    assert int(inspect(image, "{{.Size}}")) <= 260_000_000
    container = docker("create", image)
    try:
        program = ("docker", "cp", "--follow-link", f"{container}:/usr/bin/python3", "-")
        archive = subprocess.run(program, capture_output=True, check=True).stdout
    finally:
        docker("rm", container)
    # A tar archive's header is 512 bytes.
    assert archive[512:516] == b"\x7fELF"
    assert int.from_bytes(archive[530:532], "little") == MACHINES[platform]


def test_edit_of_the_node_is_one_small_layer(image: str, tmp_path: Path) -> None:
    """After a change of one line, all other layers are the ones that robots already have."""
    for part in ("docker", "talker", "fleet/ros/tcpros.py", ".dockerignore"):
        source, copy = PROJECT / part, tmp_path / part
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(source, copy) if source.is_dir() else shutil.copy(source, copy)
    node = tmp_path / "talker/nodes/talker"
    same = build("same", desktop_platform(), context=tmp_path)
    node.write_text(node.read_text().replace("rospy.loginfo(text)", 'rospy.loginfo("now " + text)'))
    edited = build("edited", desktop_platform(), context=tmp_path)
    layers = [json.loads(inspect(name, "{{json .RootFS.Layers}}")) for name in (image, same, edited)]
    assert layers[0] == layers[1]
    assert layers[0][:-1] == layers[2][:-1]
    assert layers[0][-1] != layers[2][-1]


def test_talks_prints_is_healthy_and_stops(image: str, start: Start) -> None:
    """The whole life of a container: messages as promised, the same in its log, healthy, gone when asked to."""
    robot = start(image)
    message = first_message(robot, within=30)
    year = time.strftime("%Y", time.gmtime())
    assert message.startswith(f'data: "{year}-')
    said = message.removeprefix('data: "').removesuffix('"')
    assert f"[INFO] {said}" in docker("logs", NAME).splitlines()
    wait_for("{{.State.Health.Status}}", "healthy", within=30)
    assert inside("id", "--user").stdout.strip() == "1000"
    began = time.monotonic()
    docker("stop", NAME)
    # It takes 2 s where nothing else runs; after 10 s Docker would have killed it.
    assert time.monotonic() - began < 8
    assert inspect(NAME, "{{.State.ExitCode}}") != "137"


def test_passes_the_packages_own_test(start: Start) -> None:
    """rostest starts a real roscore and the launch file, and test_node.py subscribes with rospy."""
    rostest = build("rostest", desktop_platform(), "--build-arg=EXTRA_PACKAGES=python3-rostest")
    tests = f"{PROJECT / 'talker/test'}:/opt/talker/share/talker/test:ro"
    start(rostest, "--volume", tests)
    done = inside("rostest", "talker", "talker.test")
    assert done.returncode == 0, done.stdout
    assert "* TESTS: 2" in done.stdout
    assert "* FAILURES: 0" in done.stdout


def test_writes_no_log_files(image: str, start: Start) -> None:
    """A robot's card does not fill: what ROS would write again and again is not there."""
    first_message(start(image), within=30)
    sizes = inside("find", "/home/ros", "-type", "f", "-printf", "%s %p\n").stdout.splitlines()
    assert sum(int(line.split()[0]) for line in sizes) < 10_000, sizes


def test_stopped_node_is_unhealthy_and_silent(image: str, start: Start) -> None:
    """A node that hangs keeps its sockets open; the health check and `listen` notice, and say so."""
    robot = start(image)
    first_message(robot, within=30)
    suspend = "import os, pathlib, signal; [os.kill(int(p.parent.name), signal.SIGSTOP) for p in "
    suspend += (
        "pathlib.Path('/proc').glob('[0-9]*/cmdline') if b'\\0/opt/talker/lib/talker/' in p.read_bytes()]"
    )
    assert inside("python3", "-c", suspend).returncode == 0
    check = inside(*HEALTH)
    assert check.returncode == 1
    assert check.stdout.startswith("/time: ")
    with pytest.raises(TimedOut):
        next(listen.messages(robot, "/time", timeout=1))


def test_killed_node_comes_back(image: str, start: Start) -> None:
    """The container ends with its node, and Docker starts it again."""
    robot = start(image)
    first_message(robot, within=30)
    assert inside("rosnode", "kill", "/talker").returncode == 0
    wait_for("{{.RestartCount}}", "1", within=30)
    assert first_message(robot, within=30)


def test_hostname_that_is_loopback_is_told(image: str, start: Start) -> None:
    """The classic mistake, with a real roscore: it then listens to the robot itself only."""
    robot = start(image, hostname="localhost")
    wait_for("{{.State.Health.Status}}", "healthy", within=30)
    with pytest.raises(NotAsPlanned, match="call themselves localhost") as caught:
        next(listen.messages(robot, "/time", timeout=5))
    assert caught.value.cure == f"set ros.ip of pi1 to {robot.address}, then run `fab ship`"


def test_name_that_only_others_resolve(image: str, start: Start) -> None:
    """raspberrypi.local means nothing inside the container, until Compose's extra_hosts says it is itself."""
    start(image, "--add-host", "pi1.local:127.0.0.1", hostname="pi1.local")
    wait_for("{{.State.Health.Status}}", "healthy", within=30)


def test_impossible_rate_is_refused_in_the_log(image: str, start: Start) -> None:
    """A wrong value in .env ends the container with a sentence, not a traceback."""
    start(image, "--env", "TALKER_RATE=fast")
    wait_for("{{.State.Restarting}}", "true", within=30)
    log = subprocess.run(("docker", "logs", NAME), capture_output=True, text=True, check=True)
    assert "talker: rate is 'fast', which is not a number of messages a second" in log.stderr
    assert "Traceback" not in log.stderr + log.stdout


def test_starts_on_a_busy_small_board(image: str, start: Start) -> None:
    """With a fiftieth of a processor the master needs longer than roslaunch would give it."""
    robot = start(image, "--cpus", "0.02", "--no-healthcheck")
    assert first_message(robot, within=300)
    assert inspect(NAME, "{{.RestartCount}}") == "0"


def test_namespace_and_rate_come_from_the_environment(image: str, start: Start) -> None:
    """What .env says reaches the node; the health check follows the namespace."""
    robot = start(image, "--env", "TALKER_RATE=20", "--env", "ROS_NAMESPACE=pi1")
    robot = robot.model_copy(update={"ros": robot.ros.model_copy(update={"namespace": "pi1"})})
    first_message(robot, within=30)
    began = time.monotonic()
    arriving = listen.messages(robot, "time", timeout=5)
    assert len(list(itertools.islice(arriving, 21))) == 21
    assert time.monotonic() - began < 5
    assert inside(*HEALTH).returncode == 0


def test_ros_base_image_is_set_up_by_the_entry_point(start: Start, tmp_path: Path) -> None:
    """On a base like ros:noetic-ros-core only the talker is added, and the base's own setup file is read."""
    ros = build("ros", desktop_platform(), "--target=ros")
    setup = "export ROS_PACKAGE_PATH=/usr/share CMAKE_PREFIX_PATH=/usr PYTHONPATH= FROM_SETUP=yes"
    (tmp_path / "Dockerfile").write_text(
        f"FROM {ros}\nRUN mkdir -p /opt/ros/noetic && echo '{setup}' > /opt/ros/noetic/setup.sh\n"
    )
    base = f"{NAME}:like-noetic"
    command = (*buildkit_client(), "build", "--tag", base, str(tmp_path))
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    start(build("on-noetic", desktop_platform(), f"--build-arg=ROS_BASE={base}"))
    wait_for("{{.State.Health.Status}}", "healthy", within=30)
    assert "FROM_SETUP=yes" in inside("cat", "/proc/1/environ").stdout.split("\0")


@pytest.mark.parametrize("platform", ["linux/arm64", "linux/arm/v7"])
def test_arm_image_talks(platform: str, start: Start) -> None:
    """The very image that a Pi gets, under emulation."""
    if not emulates(platform):
        pytest.skip(f"this computer does not emulate {platform}")
    debianarchive.base(platform)
    robot = start(build(platform.replace("/", "-"), platform), "--platform", platform)
    assert first_message(robot, within=120).startswith('data: "')
    wait_for("{{.State.Health.Status}}", "healthy", within=120)
