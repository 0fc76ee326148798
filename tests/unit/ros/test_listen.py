from __future__ import annotations

import contextlib
import errno
import os
import socket
import time
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.errors import LinkLost, NotAsPlanned, RobotError, TimedOut, Unreachable
from fleet.ros import listen, tcpros
from tests.support.ros_peers import Peers, answering, serving, string_message

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def peers() -> Iterator[Peers]:
    with Peers(messages=(string_message("noon"), string_message("later"))).run() as running:
        yield running


@pytest.fixture(scope="session")
def outside() -> str:
    """An IPv4 address of this computer that is no loopback address, as a robot's would be."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # sends nothing; asks the routing table
        return str(probe.getsockname()[0])
    pytest.skip("this computer has no address but loopback")


def robot(master_port: int, *, address: str = "127.0.0.1", **settings: str) -> Robot:
    """A robot with its own master, at a port of its own so that a real roscore does not matter."""
    ros = Ros.model_validate({"master": f"http://localhost:{master_port}"} | settings)
    return Robot(name="pi1", address=address, ros=ros)


def first(of: Robot, topic: str = "/time", *, timeout: float = 5) -> str:
    with contextlib.closing(listen.messages(of, topic, timeout=timeout)) as arriving:
        return next(arriving).text()


def failure(of: Robot, topic: str = "/time", *, timeout: float = 5) -> RobotError:
    with pytest.raises(RobotError) as caught:
        first(of, topic, timeout=timeout)
    assert not caught.value.what.endswith(".")
    return caught.value


def test_messages_arrive_in_order(peers: Peers) -> None:
    """Every message is yielded as text, one after the other."""
    arriving = listen.messages(robot(peers.master_port), "/time", timeout=5)
    assert [next(arriving).text(), next(arriving).text()] == ['data: "noon"', 'data: "later"']


def test_relative_topic_follows_the_robots_namespace(peers: Peers) -> None:
    """`time` is what the robot's own nodes would mean by it."""
    peers.topic = "/pi1/time"
    assert first(robot(peers.master_port, namespace="pi1"), "time") == 'data: "noon"'


def test_master_name_unknown() -> None:
    """A robot's address that only OpenSSH knows is no name for ROS."""
    problem = failure(robot(11311, address="nobody.invalid"))
    assert isinstance(problem, Unreachable)
    assert "nobody.invalid does not resolve" in problem.what
    assert "set ros.hostname or ros.ip of pi1" in problem.cure


def test_master_found_by_the_hostname_where_the_address_is_an_alias(peers: Peers) -> None:
    """With ros.hostname set, an address that only OpenSSH knows is no obstacle."""
    alias = robot(peers.master_port, address="nobody.invalid", hostname="127.0.0.1")
    assert first(alias) == 'data: "noon"'


def test_no_master_listens() -> None:
    """A closed port is told apart from a robot that is away."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    problem = failure(robot(port))
    assert isinstance(problem, Unreachable)
    assert problem.what == f"no ROS master listens at http://127.0.0.1:{port}"
    assert "fab status --hosts pi1" in problem.cure


def test_nodes_that_listen_to_their_robot_only() -> None:
    """A hostname that is loopback binds a real master to loopback: its port looks closed from outside."""
    refused = tcpros.NoConnection("10.0.0.1", 11311, os.strerror(errno.ECONNREFUSED))
    pi1 = Robot(name="pi1", address="10.0.0.1", ros=Ros(hostname="localhost"))
    problem = listen.no_master(refused, robot=pi1, master="http://10.0.0.1:11311")
    assert problem.what == "the ROS nodes of pi1 call themselves localhost, so only pi1 itself can reach them"
    assert problem.cure == "set ros.ip of pi1 to 10.0.0.1, then run `fab ship`"


def test_master_out_of_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    """A full backlog swallows connections as a firewall that drops does."""
    monkeypatch.setattr(listen, "STEP", 0.5)
    with socket.socket() as full, contextlib.ExitStack() as stuck:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        for _ in range(4):
            waiting = stuck.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(full.getsockname())
        began = time.monotonic()
        problem = failure(robot(full.getsockname()[1]))
    assert isinstance(problem, Unreachable)
    assert "cannot be reached (no answer)" in problem.what
    assert time.monotonic() - began < 5


def test_master_that_answers_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stopped process still accepts connections; it is not waited for."""
    monkeypatch.setattr(listen, "STEP", 0.5)
    with serving(lambda _: time.sleep(60)) as port:
        assert "does not answer" in failure(robot(port)).what


def test_something_else_on_the_masters_port() -> None:
    """Another XML-RPC server is not mistaken for a master."""
    with answering({"getSystemState": lambda _: [1, "", 3]}) as port:
        assert "is not a working ROS master" in failure(robot(port)).what


def test_mistyped_topic(peers: Peers) -> None:
    """A near name is offered."""
    problem = failure(robot(peers.master_port), "/tiem")
    assert (problem.what, problem.cure) == ("there is no topic /tiem", "did you mean /time?")


def test_topic_in_another_namespace(peers: Peers) -> None:
    """The same name elsewhere is offered, however different the path."""
    peers.topic = "/site/pi1/time"
    assert failure(robot(peers.master_port)).cure == "did you mean /site/pi1/time?"


def test_topic_like_no_other(peers: Peers) -> None:
    """What is published is listed."""
    assert failure(robot(peers.master_port), "/odometry").cure == "published are /time"


def test_topic_without_publisher(peers: Peers) -> None:
    """A topic that somebody waits for exists, and nobody serves it."""
    peers.subscribers = [["/cmd", ["/wheels"]]]
    problem = failure(robot(peers.master_port), "/cmd")
    assert problem.what == "no node publishes /cmd, although /wheels subscribes to it"


def test_node_name_does_not_resolve(peers: Peers) -> None:
    """The classic: listed, and no data, because ROS_HOSTNAME means nothing here."""
    peers.called = "nobody.invalid"
    problem = failure(robot(peers.master_port, hostname="nobody.invalid"))
    assert isinstance(problem, NotAsPlanned)
    assert "node /talker registered as nobody.invalid, a name that does not resolve here" in problem.what
    assert problem.cure.startswith("set ros.ip of pi1 to ")


def test_node_calls_itself_localhost(outside: str) -> None:
    """A loopback address leads to the desktop: it is never connected to, and the robot's own address is the cure."""
    with Peers(host=outside, called="localhost").run() as peers:
        problem = failure(robot(peers.master_port, address=outside, hostname="localhost"))
    assert isinstance(problem, NotAsPlanned)
    assert "registered as localhost, which (127.0.0.1 here) is this computer itself" in problem.what
    assert problem.cure == f"set ros.ip of pi1 to {outside}, then run `fab ship`"


def test_node_calls_itself_by_another_machines_address(outside: str) -> None:
    """An address where the robot is not is named, with the one where it is."""
    with Peers(host="127.0.0.1", called=outside).run() as peers:
        problem = failure(robot(peers.master_port, hostname=outside))
    assert f"registered as {outside}, which is not where pi1 is" in problem.what
    assert problem.cure.startswith("set ros.ip of pi1")


def test_node_runs_with_an_older_name_than_the_inventory_has(peers: Peers) -> None:
    """What was shipped and what the inventory says by now may differ."""
    peers.called = "nobody.invalid"
    assert (
        failure(robot(peers.master_port)).cure == "the inventory says 127.0.0.1: run `fab ship --hosts pi1`"
    )


def test_node_registered_and_gone(peers: Peers) -> None:
    """A node that died without a word stays in the master's books."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        peers.node_port = listener.getsockname()[1]
    problem = failure(robot(peers.master_port))
    assert isinstance(problem, Unreachable)
    assert "node /talker is registered but does not run" in problem.what
    assert "fab restart --hosts pi1" in problem.cure


def test_node_refuses(peers: Peers) -> None:
    """The publisher's own words are told."""
    peers.error = "md5sums do not match"
    assert "md5sums do not match" in failure(robot(peers.master_port)).what


def test_silent_topic(peers: Peers) -> None:
    """A publisher without messages is silent after exactly the time that was given."""
    peers.messages = ()
    problem = failure(robot(peers.master_port), timeout=0.5)
    assert isinstance(problem, TimedOut)
    assert problem.what.startswith("/time was silent for 0.5 s")


def test_publisher_hangs_up(peers: Peers) -> None:
    """It is looked for again, as after a restart: listening goes on, and no message before the end is lost."""
    peers.hang_up = True
    with closing(listen.messages(robot(peers.master_port), "/time", timeout=5)) as arriving:
        heard = [next(arriving).text() for _ in range(4)]
    assert heard == ['data: "noon"', 'data: "later"'] * 2


def test_publisher_hangs_up_for_good(peers: Peers) -> None:
    """One that does not come back, or never sends anything, is told after the time-out."""
    peers.hang_up = True
    peers.messages = ()
    with pytest.raises(LinkLost, match="closed the connection"):
        next(listen.messages(robot(peers.master_port), "/time", timeout=1))


def test_unreadable_message(peers: Peers) -> None:
    """A message that does not fit its definition is refused with the reason."""
    peers.definition = "uint16 data\n"
    assert "/time cannot be read" in failure(robot(peers.master_port)).what


def test_shared_master_own_node_is_chosen() -> None:
    """Among many robots' publishers of one topic, the robot's own is heard."""
    uris = {"/pi1/talker": "http://10.0.0.1:4000/", "/pi2/talker": "http://10.0.0.2:4000/"}
    pi2 = Robot(name="pi2", address="10.0.0.2", ros=Ros(master="http://base:11311"))
    assert listen.own_node(uris, "/time", robot=pi2) == "/pi2/talker"


def test_shared_master_without_the_robots_own_node() -> None:
    """Another robot's messages are never shown as this one's."""
    pi3 = Robot(name="pi3", address="10.0.0.3", ros=Ros(master="http://base:11311"))
    with pytest.raises(NotAsPlanned, match=r"published by /talker at 10\.0\.0\.1, not by pi3"):
        listen.own_node({"/talker": "http://10.0.0.1:4000/"}, "/time", robot=pi3)


def test_shared_master_unreachable() -> None:
    """The cure of a shared master is not the robot's containers."""
    pi1 = Robot(name="pi1", address="10.0.0.1", ros=Ros(master="http://base:11311"))
    refused = tcpros.NoConnection("base", 11311, "Connection refused")
    problem = listen.no_master(refused, robot=pi1, master="http://base:11311")
    assert (
        problem.cure == "check that it runs, and that this computer can reach it (ros.master of pi1 names it)"
    )
