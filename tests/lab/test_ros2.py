"""ROS 2 on virtual Pis of linux/amd64: the example, stacks that are silent, and each reason why nothing arrives."""

from __future__ import annotations

import json
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from typing import TYPE_CHECKING

import pytest

from fleet.images.emulation import desktop_platform
from tests.support import ros2_image
from tests.support.lab_project import LAB, ROOT, Project, eventually, forget, on_each, wipe

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Lab, Pi
    from tests.support.lab_project import Said

IMAGE = f"{LAB}-clock"
PARTS = (".dockerignore", "docker/ros2", "fleet/ros/ros2_check.py")
NODE = "node"
"""What the container of a case is called."""

HOST = ("--network", "host", "--ipc", "host")
TALKER = ("python3", "/opt/clock/talker.py")
LISTENER = ("python3", "/opt/clock/listener.py")
BEST_EFFORT = """
import rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Header
rclpy.init()
node = rclpy.create_node("sensor")
publisher = node.create_publisher(Header, "time", qos_profile_sensor_data)
node.create_timer(0.2, lambda: publisher.publish(Header(frame_id="sensor")))
node.create_subscription(Header, "time", print, 10)
rclpy.spin(node)
"""
"""A publisher and a subscriber that do not match."""


@pytest.fixture(scope="module")
def clock(provisioned: Lab, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Project]:
    """The example for ROS 2 on all Pis, from `fab build` on."""
    if desktop_platform() != ros2_image.PLATFORM:
        pytest.skip("the packages of ROS 2 for tests are for x86-64 only")
    on_each(provisioned.pis, wipe)
    project = Project.made(tmp_path_factory.mktemp("clock"), provisioned)
    for part in PARTS:
        source, copy = ROOT / part, project.directory / part
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(source, copy) if source.is_dir() else shutil.copy(source, copy)
    project.edit("docker/ros2/compose.yaml", "image: clock", f"image: {IMAGE}")
    inventory(project)
    project.well("build", within=300)
    project.well("ship", within=300)
    yield project
    on_each(provisioned.pis, wipe)
    forget(IMAGE)


def inventory(project: Project, **ros: object) -> None:
    """The lab's Pis as what they are: computers of linux/amd64 with ROS 2."""
    values = {"ros": {"version": 2, **ros}, "environment": {"ROS_BASE": ros2_image.ensure()}}
    said = {
        "stack": "docker/ros2/compose.yaml",
        "include": [{"path": str(project.lab.inventory)}],
        "groups": {"fleet": {"robots": ["*"], "platform": ros2_image.PLATFORM, **values}},
    }
    project.write("inventory.yaml", json.dumps(said))


def test_the_example_talks(clock: Project) -> None:
    """Messages of each robot under its name; both services are healthy, so the listener hears the talker."""
    heard = clock.well("listen", "--hosts", "fleet", "--count", "1")
    for pi in clock.lab.pis:
        assert f'{pi.name} | frame_id: "{pi.name}"' in heard.out
    listed = json.loads(clock.well("topics", "--hosts", "pi1", "--rate", "--json").out)["pi1"]
    topics = {one["name"]: one for one in listed}
    assert topics["/time"]["type"] == "std_msgs/msg/Header"
    assert topics["/time"]["subscribers"] >= 1
    assert topics["/time"]["unmatched"] == topics["/delay"]["unmatched"] == []
    assert 0 < topics["/delay"]["rate"] < 3


def test_measured_and_on_the_robot(clock: Project) -> None:
    """The delay of messages is small, by either clock; messages over SSH are said to be such."""
    near = ("listen", "--hosts", "pi1", "--delay", "--count", "1", "--json")
    for more in ((), ("--via", "robot")):
        report = json.loads(clock.well(*near, *more).out)
        assert 0 < report["rate"] < 5
        assert -0.5 < report["delay"] < 5
    said = clock.well("listen", "--hosts", "pi1", "--via", "robot", "--count", "1")
    assert "frame_id" in said.out
    assert "heard on the robot itself, in the container clock-" in said.err
    left = "ps ax | grep -c '[-]-all' || true"
    assert eventually(lambda: clock.lab.pis[0].exec("sh", "-c", left) == "0")


def test_a_silent_stack_is_warned_about(clock: Project) -> None:
    """With the lines that cure it, and refused if the inventory is strict; a middleware that is missing is told."""
    compose = (clock.directory / "docker/ros2/compose.yaml").read_text()
    try:
        clock.edit("docker/ros2/compose.yaml", "  ipc: host\n", "")
        said = clock.well("ship", "--dry", "--hosts", "pi1")
        assert "pi1: no message of ROS 2 will arrive between listener and talker" in said.err
        assert "`ipc: host`" in said.err
        assert "`FASTDDS_BUILTIN_TRANSPORTS: UDPv4`" in said.err
        inventory(clock, strict=True)
        assert clock.fab("ship", "--hosts", "pi1").code == 2
        clock.write("docker/ros2/compose.yaml", compose)
        inventory(clock, rmw="rmw_cyclonedds_cpp")
        said = clock.well("ship", "--dry", "--hosts", "pi1")
        assert f"{IMAGE} has no rmw_cyclonedds_cpp, only rmw_fastrtps_cpp" in said.err
    finally:
        clock.write("docker/ros2/compose.yaml", compose)
        inventory(clock)


def node(pi: Pi, *options: str, name: str = NODE, program: tuple[str, ...] = TALKER) -> None:
    """Start a node of the example's image in a container of its own."""
    image = pi.exec(
        "sh", "-c", f"docker image ls --format '{{{{.Repository}}}}:{{{{.Tag}}}}' {IMAGE} | head -n 1"
    )
    pi.exec(
        "docker",
        "run",
        "--detach",
        "--name",
        name,
        "--env",
        f"FLEET_ROBOT={pi.name}",
        *options,
        image,
        *program,
    )


@dataclass(frozen=True, kw_only=True)
class Case:
    """A set-up on one Pi, and what `fab listen` says about it. Without an error, a message arrives."""

    says: str = ""
    options: tuple[str, ...] = HOST
    program: tuple[str, ...] = TALKER
    listen: tuple[str, ...] = ()
    firewall: tuple[str, ...] = ()
    runs: bool = True
    count: int = 3
    arrives: bool = False


CASES = {
    "plain": Case(arrives=True),
    "another domain": Case(
        options=(*HOST, "--env", "ROS_DOMAIN_ID=7"), says="are in domain 7, and the inventory says 0"
    ),
    "localhost only": Case(options=(*HOST, "--env", "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"), arrives=True),
    "discovery off": Case(
        options=(*HOST, "--env", "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF"),
        says="look for nobody on other computers: ROS_AUTOMATIC_DISCOVERY_RANGE=OFF in node",
    ),
    "own network": Case(options=(), says="node has a network of its own (bridge)"),
    "own network, on the robot": Case(
        options=(), listen=("--via", "robot"), says="in the container node, and not over", arrives=True
    ),
    "mistyped": Case(listen=("--topic", "/tiem"), says="did you mean /time?"),
    "nothing runs": Case(runs=False, says="no container runs on"),
    "multicast blocked": Case(firewall=("OUTPUT", "--destination", "239.0.0.0/8"), arrives=True),
    "UDP blocked": Case(
        firewall=("INPUT", "--protocol", "udp", "!", "--in-interface", "lo"),
        says="`fab listen --via robot` listens in a container",
    ),
    "UDP blocked, on the robot": Case(
        firewall=("INPUT", "--protocol", "udp", "!", "--in-interface", "lo"),
        listen=("--via", "robot"),
        says="in the container node, and not over",
        arrives=True,
    ),
    "quality": Case(
        program=("python3", "-c", BEST_EFFORT),
        says="matches no publisher: it wants reliable messages, and the publisher is best effort",
        count=20,
        arrives=True,
    ),
}


def judged(project: Project, pi: Pi, case: Case) -> Said:
    """What `fab listen` says of a Pi on which nothing but the case runs."""
    if case.runs:
        node(pi, *case.options, program=case.program)
        eventually(lambda: pi.exec("docker", "inspect", "--format", "{{.State.Running}}", NODE) == "true")
        time.sleep(2)  # the node itself needs a moment, and the reason would be another one
    if case.firewall:
        pi.exec("iptables", "--append", *case.firewall, "--jump", "DROP")
    try:
        listen = (
            "listen",
            "--hosts",
            pi.name,
            "--timeout",
            "15" if case.arrives else "5",
            "--count",
            str(case.count),
        )
        return project.fab(*listen, *case.listen)
    finally:
        if case.firewall:
            pi.exec("iptables", "--delete", *case.firewall, "--jump", "DROP")
        pi.exec("sh", "-c", f"docker rm --force {NODE} 2>/dev/null || true")


@pytest.fixture(scope="module")
def verdicts(clock: Project) -> dict[str, Said]:
    """All cases, one on each Pi at a time: most of it is waiting."""
    clock.well("stop", "--hosts", "fleet")
    free: SimpleQueue[Pi] = SimpleQueue()
    for pi in clock.lab.pis:
        free.put(pi)

    def judge(case: Case) -> Said:
        pi = free.get()
        try:
            return judged(clock, pi, case)
        finally:
            free.put(pi)

    with ThreadPoolExecutor(len(clock.lab.pis)) as pool:
        return dict(zip(CASES, pool.map(judge, CASES.values()), strict=True))


@pytest.mark.parametrize("name", CASES)
def test_each_reason_is_named(verdicts: dict[str, Said], name: str) -> None:
    """A message arrives, or the reason is told with a cure; and sometimes both."""
    case, said = CASES[name], verdicts[name]
    assert said.code == (0 if case.arrives else 1), said.all
    assert ("frame_id" in said.out) == case.arrives
    assert case.says in said.err
    assert case.arrives or "cure: " in said.err


def test_containers_that_share_no_memory_are_silent(verdicts: dict[str, Said], clock: Project) -> None:
    """They find each other and hear nothing, as the warning says; with its second cure, messages arrive."""
    assert verdicts
    one, other, _ = clock.lab.pis
    cured = ("--env", "FASTDDS_BUILTIN_TRANSPORTS=UDPv4")
    for pi, options in ((one, ("--network", "host")), (other, ("--network", "host", *cured))):
        node(pi, *options)
        node(pi, *options, name="listener", program=LISTENER)

    def heard(pi: Pi) -> int:
        return int(pi.exec("sh", "-c", "docker logs listener 2>&1 | grep -c 'heard ' || true"))

    assert eventually(lambda: heard(other) > 2, within=30)
    listed = json.loads(clock.well("topics", "--hosts", one.name, "--json").out)[one.name]
    assert [topic["subscribers"] for topic in listed if topic["name"] == "/time"] == [1]
    assert heard(one) == 0
    on_each(
        clock.lab.pis,
        lambda pi: pi.exec("sh", "-c", f"docker rm --force {NODE} listener 2>/dev/null || true"),
    )
