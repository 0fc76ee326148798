from __future__ import annotations

import base64
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fleet.ros import ros2_check

RCLPY = '''
import os, sys, types
OFFERED = dict(pair.split("=") for pair in os.environ["OFFERED"].split())
class Node:
    """One publisher of each topic in OFFERED, such as /time=std_msgs/msg/String; /silent sends nothing."""
    def __init__(self, name, **options):
        assert options == {"start_parameter_services": False, "enable_rosout": False}
        self.heard = None
    def get_publishers_info_by_topic(self, topic):
        if topic == "/broken":
            raise RuntimeError("the middleware\\nis not there")
        durability = 1 if topic == "/map" else 2
        quality = types.SimpleNamespace(durability=durability)
        return [types.SimpleNamespace(topic_type=OFFERED[topic], qos_profile=quality)] if topic in OFFERED else []
    def create_subscription(self, kind, topic, heard, quality, raw):
        assert raw and kind.__name__ == "String", kind
        assert (quality.durability, quality.reliability) == ((1, 1) if topic == "/map" else (2, 2))
        print("depth", quality.depth, file=sys.stderr)
        self.heard = None if topic == "/silent" else heard
        return self
def init(args):
    assert args == []
def shutdown():
    print("left", file=sys.stderr)
def create_node(name, **options):
    return Node(name, **options)
def spin_once(node, timeout_sec):
    if node.heard:
        node.heard(b"bytes")
'''
QOS = """
import types
DurabilityPolicy = types.SimpleNamespace(TRANSIENT_LOCAL=1, VOLATILE=2)
ReliabilityPolicy = types.SimpleNamespace(RELIABLE=1, BEST_EFFORT=2)
QoSProfile = types.SimpleNamespace
"""
OFFERED = (
    "/time=std_msgs/msg/String /map=std_msgs/msg/String /silent=std_msgs/msg/String /pi1/time=std_msgs/msg/String "
    "/own=own_msgs/msg/Thing /odd=String"
)


@pytest.fixture
def ros(tmp_path: Path) -> Path:
    """Packages with the names of ROS 2's, which do what rclpy does as far as the check can see."""
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy/__init__.py").write_text(RCLPY)
    (tmp_path / "rclpy/qos.py").write_text(QOS)
    (tmp_path / "std_msgs").mkdir()
    (tmp_path / "std_msgs/msg.py").write_text("class String: pass\n")
    return tmp_path


def check(
    topic: str, packages: Path | None, *, timeout: str = "3", **environment: str
) -> subprocess.CompletedProcess[str]:
    """The file as a container's health check runs it, in the environment of ROS."""
    return subprocess.run(
        (sys.executable, str(ros2_check.__file__), topic, "--timeout", timeout),
        env={
            "PYTHONPATH": str(packages or ""),
            "AMENT_PREFIX_PATH": "/opt",
            "OFFERED": OFFERED,
            **environment,
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.mark.parametrize("topic", ["/time", "time", "/map"])
def test_one_message_is_enough(ros: Path, topic: str) -> None:
    """Healthy, and nothing is printed; the node leaves. A topic that keeps its last message is asked for that one."""
    done = check(topic, ros)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "depth 1\nleft\n")


def test_a_relative_topic_follows_the_namespace(ros: Path) -> None:
    """As in the inventory, with or without a slash."""
    for namespace in ("pi1", "/pi1"):
        assert check("time", ros, ROS_NAMESPACE=namespace).returncode == 0


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        ("/none", "/none: nobody publishes it"),
        ("/silent", "/silent: its publisher sent nothing for 0.3 s"),
        ("/own", "/own: this container has no Python package with own_msgs/msg/Thing"),
        ("/odd", "/odd: 'String' is not a type of ROS"),
        ("/broken", "/broken: RuntimeError: the middleware"),
    ],
)
def test_the_reason_is_one_line(ros: Path, topic: str, reason: str) -> None:
    """`docker inspect` shows it."""
    done = check(topic, ros, timeout="0.3")
    assert (done.returncode, done.stdout) == (1, f"{reason}\n")
    assert done.stderr.removeprefix("depth 1\n") == "left\n"


def test_a_container_without_ros() -> None:
    """That is said, too."""
    done = check("/time", None)
    assert done.returncode == 1
    assert done.stdout.startswith("/time: rclpy cannot be imported (No module named 'rclpy'")


def test_the_environment_of_the_containers_program(tmp_path: Path) -> None:
    """The first process that has one; others may have ended, or be somebody else's."""
    for number, entries in (
        ("10", b"AMENT_PREFIX_PATH=/late\0"),
        ("9", b"A=b=c\0odd\0AMENT_PREFIX_PATH=/opt/ros\0"),
    ):
        (tmp_path / number).mkdir()
        (tmp_path / number / "environ").write_bytes(entries)
    (tmp_path / "1").mkdir()
    (tmp_path / "2").mkdir()
    (tmp_path / "2/environ").write_bytes(b"PATH=/bin\0")
    assert ros2_check.adopted(tmp_path) == {"A": "b=c", "AMENT_PREFIX_PATH": "/opt/ros"}
    assert ros2_check.adopted(tmp_path / "none") == {}


def test_a_check_adopts_that_environment(ros: Path) -> None:
    """Docker starts it without the environment of ROS: it is still healthy."""
    environment = {"AMENT_PREFIX_PATH": "/opt", "PYTHONPATH": str(ros), "OFFERED": OFFERED}
    script = "import time; time.sleep(60)"
    with subprocess.Popen((sys.executable, "-c", script), env=environment) as program:
        try:
            code = f"""
import importlib.util, pathlib, sys
sys.argv = [{str(ros2_check.__file__)!r}, "/time"]
spec = importlib.util.spec_from_file_location("check", sys.argv[0])
check = importlib.util.module_from_spec(spec)
spec.loader.exec_module(check)
class Container(pathlib.PosixPath):  # this computer may have other programs with ROS
    def glob(self, _): return [pathlib.Path("/proc/{program.pid}")]
check.Path = Container
sys.exit(check.main())
"""
            done = subprocess.run(
                (sys.executable, "-c", code), env={}, capture_output=True, text=True, check=False
            )
        finally:
            program.kill()
    assert (done.returncode, done.stdout) == (0, "")


def following(ros: Path, topic: str, *, timeout: str = "3") -> subprocess.Popen[str]:
    """The program as it travels to a container, as a string, with ``--all``."""
    program = Path(ros2_check.__file__).read_text()
    argv = (sys.executable, "-c", program, topic, "--timeout", timeout, "--all")
    environment = {"PYTHONPATH": str(ros), "AMENT_PREFIX_PATH": "/opt", "OFFERED": OFFERED}
    return subprocess.Popen(
        argv,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize(("topic", "depth"), [("/time", 100), ("/map", 1000)])
def test_all_messages_as_lines(ros: Path, topic: str, depth: int) -> None:
    """Type, time and bytes; it ends when its input ends, as after a lost link, and leaves nothing behind.

    Messages that come together are all wanted.
    """
    with following(ros, topic) as running:
        assert running.stdin
        assert running.stdout
        first, second = (json.loads(running.stdout.readline()) for _ in range(2))
        running.stdin.close()
        assert running.wait(timeout=20) == 0
        running.stdout.read()
        assert running.stderr
        assert running.stderr.readline() == f"depth {depth}\n"
    assert base64.b64decode(first["data"]) == b"bytes"
    assert first["type"] == "std_msgs/msg/String"
    assert time.time() - 60 < first["at"] <= second["at"] <= time.time()
    assert first["monotonic"] <= second["monotonic"] <= time.monotonic()


def test_all_messages_of_a_silent_topic(ros: Path) -> None:
    """The reason, and code 1; without ROS it is another code, because the next container may have it."""
    with following(ros, "/silent", timeout="0.3") as running:
        assert running.stdout
        said = running.stdout.read()
    assert (running.returncode, said) == (1, "/silent: its publisher sent nothing for 0.3 s\n")
    with following(ros, "/none", timeout="0.3") as running:
        assert running.stdout
        said = running.stdout.read()
    assert (running.returncode, said) == (ros2_check.UNPUBLISHED, "/none: nobody publishes it\n")
    with following(ros / "nothing", "/time") as running:
        assert running.stdout
        said = running.stdout.read()
    assert (running.returncode, said[:36]) == (ros2_check.NO_ROS, "/time: rclpy cannot be imported (No ")


def test_our_own_variables_stay() -> None:
    """Shared memory is switched off for a listener, whatever the container's program has."""
    done = subprocess.run(
        (sys.executable, "-c", "from fleet.ros import ros2_check; print(ros2_check.overruled())"),
        env={
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "HOME": "/",
            "PYTHONPATH": str(Path(__file__).parents[3]),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "{'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}\n"
