from __future__ import annotations

import ast
import base64
import json
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.ros import tcpros
from tests.support.ros_peers import Peers, answering, serving, string_message

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def peers() -> Iterator[Peers]:
    with Peers(messages=(string_message("noon"),)).run() as running:
        yield running


def soon(seconds: float = 5) -> float:
    return time.monotonic() + seconds


def health(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the file as the container does: isolated, without site packages."""
    return subprocess.run(
        (sys.executable, "-S", tcpros.__file__, *arguments),
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
        env=environment,
    )


def test_first_message_goes_all_the_way(peers: Peers) -> None:
    """Master, node and publisher are asked in turn, and the bytes are those that were sent."""
    assert tcpros.first_message(peers.master, "/time", deadline=soon()) == string_message("noon")[4:]


def test_stream_knows_type_and_definition(peers: Peers) -> None:
    """The publisher's header says what the bytes mean."""
    stream = tcpros.Stream("127.0.0.1", peers.data_port, "/time", deadline=soon())
    assert (stream.type, stream.definition) == (peers.type, peers.definition)
    stream.close()


def test_graph_has_publishers_and_subscribers(peers: Peers) -> None:
    """Both sides of the master's books are read."""
    peers.subscribers = [["/cmd", ["/wheels"]]]
    graph = tcpros.graph(peers.master, deadline=soon())
    assert graph == ({"/time": ["/talker"]}, {"/cmd": ["/wheels"]})


def test_unknown_node_is_the_masters_no(peers: Peers) -> None:
    """A status other than 1 becomes `Refused` with the master's words."""
    with pytest.raises(tcpros.Refused, match=r"unknown node \[/gone\]"):
        tcpros.node_uri(peers.master, "/gone", deadline=soon())


def test_unpublished_topic(peers: Peers) -> None:
    """A topic without a publisher is no silent success."""
    with pytest.raises(tcpros.NotPublished, match="nobody publishes /tim "):
        tcpros.first_message(peers.master, "/tim", deadline=soon())


def test_publisher_that_refuses(peers: Peers) -> None:
    """An error in the connection header is told."""
    peers.error = "md5sums do not match"
    with pytest.raises(tcpros.Refused, match="md5sums do not match"):
        tcpros.first_message(peers.master, "/time", deadline=soon())


def test_silent_publisher_is_given_up_in_time(peers: Peers) -> None:
    """A connected publisher without messages costs what was allowed, not more."""
    peers.messages = ()
    began = time.monotonic()
    with pytest.raises(tcpros.Silent):
        tcpros.first_message(peers.master, "/time", deadline=soon(0.5))
    assert 0.4 < time.monotonic() - began < 3


def test_publisher_that_hangs_up(peers: Peers) -> None:
    """An ended connection is `Closed`, even in the middle of a message."""
    peers.messages, peers.hang_up = (string_message("noon")[:-2],), True
    with pytest.raises(tcpros.Closed):
        tcpros.first_message(peers.master, "/time", deadline=soon())


def test_absurd_length_is_refused(peers: Peers) -> None:
    """Four bytes that announce 4 GB do not make us wait for, or allocate, 4 GB."""
    peers.messages = (b"\xff\xff\xff\xff",)
    with pytest.raises(tcpros.Refused, match="does not speak TCPROS"):
        tcpros.first_message(peers.master, "/time", deadline=soon())


def test_dripping_master_is_given_up_in_time() -> None:
    """A peer that sends a byte now and then does not stretch the deadline."""

    def drip(peer: socket.socket) -> None:
        while True:
            peer.sendall(b"H")
            time.sleep(0.05)

    with serving(drip) as port:
        began = time.monotonic()
        with pytest.raises(tcpros.Silent):
            tcpros.graph(f"http://127.0.0.1:{port}", deadline=soon(0.5))
        assert time.monotonic() - began < 3


@pytest.mark.parametrize(
    "answer", [b"", b"SSH-2.0-OpenSSH_9.2\r\n", b"HTTP/1.0 200 OK\r\n\r\n<methodResponse/>"]
)
def test_something_else_listens_there(answer: bytes) -> None:
    """A port that speaks another language is `Refused`, whatever it says."""

    def answer_that(peer: socket.socket) -> None:
        peer.recv(10000)
        peer.sendall(answer)

    with serving(answer_that) as port, pytest.raises(tcpros.Refused, match="does not speak ROS"):
        tcpros.graph(f"http://127.0.0.1:{port}", deadline=soon())


def test_closed_port() -> None:
    """A refused connection names host, port and the system's reason."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(tcpros.NoConnection, match=f"127.0.0.1 port {port}: Connection refused") as caught:
        tcpros.graph(f"http://127.0.0.1:{port}", deadline=soon())
    assert caught.value.refused


def test_unknown_name() -> None:
    """A name that cannot exist is `NameUnknown`."""
    with pytest.raises(tcpros.NameUnknown, match=r"nobody\.invalid"):
        tcpros.graph("http://nobody.invalid:11311", deadline=soon())


@pytest.mark.parametrize("uri", ["", "pi1:11311", "http://pi1", "http://pi1:port", "http://[::1"])
def test_broken_uri(uri: str) -> None:
    """A URI without host or port is refused before anything is asked."""
    with pytest.raises(tcpros.Refused, match="not a URI"):
        tcpros.address_of(uri)


@pytest.mark.parametrize(
    ("topic", "namespace", "full"),
    [
        ("time", "", "/time"),
        ("time", "pi1", "/pi1/time"),
        ("a/b", "/x/", "/x/a/b"),
        ("/time", "pi1", "/time"),
    ],
)
def test_resolved(topic: str, namespace: str, full: str) -> None:
    """Relative names follow the namespace, absolute ones do not."""
    assert tcpros.resolved(topic, namespace) == full


def test_health_check_says_nothing_when_a_message_came(peers: Peers) -> None:
    """Exit code 0 is the proof of one message."""
    done = health("time", ROS_MASTER_URI=peers.master)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_health_check_says_why_in_one_line(peers: Peers) -> None:
    """Exit code 1 comes with one line that names the topic, in the node's own namespace."""
    done = health("time", "--master", peers.master, ROS_NAMESPACE="pi1")
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout == f"/pi1/time: nobody publishes /pi1/time at {peers.master}\n"


def test_health_check_needs_no_other_file(peers: Peers, tmp_path: Path) -> None:
    """The image carries this one file: nothing beside it may be needed."""
    copy = tmp_path / "tcpros.py"
    copy.write_bytes(Path(tcpros.__file__).read_bytes())
    done = subprocess.run(
        (sys.executable, "-IS", str(copy), "/time", "--master", peers.master),
        check=False,
        timeout=30,
        cwd=tmp_path,
    )
    assert done.returncode == 0


def test_python_38_can_read_it() -> None:
    """A ROS Noetic image has Python 3.8."""
    ast.parse(Path(tcpros.__file__).read_text(), feature_version=(3, 8))


def test_all_messages_as_lines(peers: Peers) -> None:
    """As for ROS 2, with the definition of the type; the end of the publisher is the end, and so is that of the input."""
    peers.messages = (string_message("noon"), string_message("later"))
    program = Path(tcpros.__file__).read_text()
    argv = (sys.executable, "-c", program, "/time", "--master", peers.master, "--all", "--timeout", "0.5")
    with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout
        *lines, reason = running.stdout.read().splitlines()
        assert running.wait(timeout=20) == 1
    found = [json.loads(line) for line in lines]
    assert [base64.b64decode(one["data"]) for one in found] == [m[4:] for m in peers.messages]
    assert {(one["type"], one["definition"]) for one in found} == {("std_msgs/String", peers.definition)}
    assert found[0]["at"] <= found[1]["at"]
    assert found[0]["monotonic"] <= found[1]["monotonic"]
    assert "is connected and says nothing" in reason
    with subprocess.Popen((*argv[:-1], "30"), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as running:
        assert running.stdin
        assert running.stdout
        running.stdout.readline()
        running.stdin.close()
        assert running.wait(timeout=20) == 0


@pytest.mark.parametrize("port", [10**30, 70_000, 65_536, 0, -1])
def test_a_port_that_is_none(port: int) -> None:
    """A node that says so is refused; the system would raise."""
    with (
        answering({"requestTopic": lambda *_: [1, "", ["TCPROS", "127.0.0.1", str(port)]]}) as node,
        pytest.raises(tcpros.Refused, match="in no form"),
    ):
        tcpros.data_address(f"http://127.0.0.1:{node}", "/time", deadline=soon())
    text = f"<value><int>{port}</int></value>"
    value = (
        "<value><array><data><value>TCPROS</value><value>127.0.0.1</value>" + text + "</data></array></value>"
    )
    answer = f"<value><array><data><value><int>1</int></value><value/>{value}</data></array></value>"
    body = f"<methodResponse><params><param>{answer}</param></params></methodResponse>"

    def say(peer: socket.socket) -> None:
        peer.recv(10_000)
        peer.sendall(b"HTTP/1.0 200 OK\r\n\r\n" + body.encode())

    with serving(say) as node, pytest.raises(tcpros.Refused, match="in no form"):
        tcpros.data_address(f"http://127.0.0.1:{node}", "/time", deadline=soon())


def test_a_peers_own_words_are_cut() -> None:
    """A reason is a sentence, also if a node says eight megabytes."""
    assert len(str(tcpros.Refused("no" * 4_000_000))) < 600


@pytest.mark.parametrize(
    ("master", "code"), [("http://nobody.invalid:11311", 3), ("http://127.0.0.1:9", 3), ("", 4)]
)
def test_another_container_may_hear_it(peers: Peers, master: str, code: int) -> None:
    """With ``--all``: the master cannot be reached from here, or nobody publishes the topic there."""
    command = (sys.executable, "-S", tcpros.__file__, "/tim", "--all", "--timeout", "2")
    with subprocess.Popen(
        (*command, "--master", master or peers.master), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as running:
        assert running.stdout
        assert len(running.stdout.read().splitlines()) == 1
        assert running.wait(timeout=20) == code
