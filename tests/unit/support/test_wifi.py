"""The emulated Wi-Fi, between namespaces that stand for robots: no Docker and no virtual Pi."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from ipaddress import IPv4Network
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.support import wifi
from tests.support.wifi import Quality, Wifi, joined

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ROOT = Path(__file__).parents[3]
HEADERS = 28  # bytes of IP and UDP before a datagram's own
PERFECT = Quality(rate=100, round_trip=(0, 0), loss=0)

ECHO = """
import socket
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind(("", 7))
while True:
    s.sendto(*s.recvfrom(2000))
"""

ASK = """
import socket, sys, time
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.settimeout(0.3)
s.connect((sys.argv[1], 7))
for _ in range(int(sys.argv[2])):
    began = time.monotonic()
    try:
        s.send(b"?")
        s.recv(2000)
    except OSError:
        continue
    print((time.monotonic() - began) * 1000)
"""
"""One line for each answer: milliseconds."""

LISTEN = """
import socket, time
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
s.bind(("", 9))
print("ready", flush=True)
count = size = first = last = 0
s.settimeout(10)
try:
    while True:
        size += len(s.recv(2000)) + 28
        count, last = count + 1, time.monotonic()
        first = first or last
        s.settimeout(0.5)
except OSError:
    print(count, size, last - first)
"""

FLOOD = """
import socket, sys, time
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.connect((sys.argv[1], 9))
rate, until = float(sys.argv[2]) * 1e6 / 8, float(sys.argv[3])
began, sent = time.monotonic(), 0
while (now := time.monotonic() - began) < until:
    while sent < now * rate:
        s.send(bytes(1200))
        sent += 1228
    time.sleep(0.002)
"""

pytestmark = pytest.mark.skipif(bool(wifi.why_not()), reason=wifi.why_not())


@pytest.fixture
def robots(desktop: None) -> Iterator[Mapping[str, int]]:  # noqa: ARG001
    """Two network namespaces, as the processes that hold them."""
    with contextlib.ExitStack() as stack:
        pids = {}
        for name in ("pi1", "pi2"):
            holder = stack.enter_context(
                subprocess.Popen(("unshare", "--net", "sh", "-c", "echo; exec sleep 600"), stdout=-1)
            )
            stack.callback(holder.kill)
            assert holder.stdout
            holder.stdout.readline()
            pids[name] = holder.pid
        yield pids


def on(pid: int, *argv: str) -> str:
    command = ("nsenter", "--target", str(pid), "--net", *argv)
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@contextlib.contextmanager
def answering(pid: int) -> Iterator[None]:
    command = ("nsenter", "--target", str(pid), "--net", sys.executable, "-c", ECHO)
    with subprocess.Popen(command) as echo:
        yield
        echo.kill()


def asked(link: Wifi, robot: str, *, times: int = 1) -> list[float]:
    """The milliseconds of each answer; those that did not come are missing."""
    command = link.at_desk(sys.executable, "-c", ASK, link.addresses[robot], str(times))
    return [float(line) for line in subprocess.run(command, capture_output=True, check=True).stdout.split()]


def flooded(
    link: Wifi, robots: Mapping[str, int], *, rate: float, seconds: float
) -> dict[str, tuple[int, int, float]]:
    """What each robot got of datagrams that the desk sent faster than the link: packets, bytes, and in how many seconds."""
    listening = {
        name: subprocess.Popen(
            ("nsenter", "--target", str(pid), "--net", sys.executable, "-c", LISTEN),
            stdout=subprocess.PIPE,
            text=True,
        )
        for name, pid in robots.items()
    }
    for listener in listening.values():
        assert listener.stdout
        listener.stdout.readline()
    flood = (sys.executable, "-c", FLOOD)
    senders = [
        subprocess.Popen(link.at_desk(*flood, link.addresses[name], str(rate), str(seconds)))
        for name in robots
    ]
    assert not any(sender.wait() for sender in senders)
    said = {name: listener.communicate()[0].split() for name, listener in listening.items()}
    return {name: (int(count), int(size), float(took)) for name, (count, size, took) in said.items()}


def test_the_rate_is_kept(robots: Mapping[str, int]) -> None:
    """Within a tenth, whatever is sent; what finds no room is dropped."""
    one = {"pi1": robots["pi1"]}
    with joined(robots, quality=Quality(rate=20, round_trip=(5, 20), loss=0)) as link:
        _, size, took = flooded(link, one, rate=30, seconds=1.2)["pi1"]
        assert size * 8 / took / 1e6 == pytest.approx(20, rel=0.1)
        assert link.traffic("pi1").to.dropped > 100


def test_robots_share_the_air(robots: Mapping[str, int]) -> None:
    """Both together get what the air has, though each link alone would carry it all."""
    with joined(robots, quality=Quality(rate=20, round_trip=(0, 0), loss=0), air=10) as link:
        got = flooded(link, robots, rate=12, seconds=1.2)
    took = max(took for _, _, took in got.values())
    assert sum(size for _, size, _ in got.values()) * 8 / took / 1e6 == pytest.approx(10, rel=0.1)


def test_the_counters_count(robots: Mapping[str, int]) -> None:
    """What went on the air was lost or arrived, and about as much is lost as was asked for."""
    quality = Quality(rate=20, round_trip=(0, 0), loss=0.1)
    with joined(robots, quality=quality) as link:
        count, size, _ = flooded(link, {"pi1": robots["pi1"]}, rate=15, seconds=1)["pi1"]
        to, back, other = link.traffic("pi1").to, link.traffic("pi1").back, link.traffic("pi2")
    assert to.sent == to.lost + count
    assert to.sent_bytes == to.lost_bytes + size
    assert to.lost / to.sent == pytest.approx(0.1, rel=0.4)
    assert (to.cut, back.sent, other.bytes) == (0, 0, 0)


def test_a_packet_is_under_way_for_as_long_as_was_asked(robots: Mapping[str, int]) -> None:
    """There and back; never less, and usually not much more than the most."""
    quality = Quality(rate=20, round_trip=(20, 40), loss=0)
    with joined(robots, quality=quality) as link, answering(robots["pi1"]):
        asked(link, "pi1", times=2)
        times = sorted(asked(link, "pi1", times=20))
    assert len(times) == 20
    assert times[0] >= 20
    assert times[10] < 50


def test_an_outage_lets_nothing_through_and_ends(robots: Mapping[str, int]) -> None:
    """By itself after its time, or when told; the other robot does not notice."""
    with joined(robots, quality=PERFECT) as link, answering(robots["pi1"]), answering(robots["pi2"]):
        assert answers(link, "pi1")
        assert answers(link, "pi2")
        link.cut(3600, "pi1")
        assert not asked(link, "pi1", times=2)
        assert asked(link, "pi2", times=3)
        assert link.traffic("pi1").to.cut >= 2
        link.cut(0, "pi1")
        assert answers(link, "pi1")
        link.cut(0.5, "pi1")
        assert answers(link, "pi1")


def answers(link: Wifi, robot: str) -> bool:
    deadline = time.monotonic() + 10
    while not (found := asked(link, robot)) and time.monotonic() < deadline:
        pass
    return bool(found)


def test_a_link_can_become_worse(robots: Mapping[str, int]) -> None:
    """While it is used."""
    with joined(robots, quality=PERFECT) as link, answering(robots["pi1"]):
        assert answers(link, "pi1")
        link.change(Quality(loss=1))
        assert not asked(link, "pi1", times=2)
        assert link.traffic("pi1").to.lost >= 2


def test_the_desk_reaches_robots_over_the_link_only(robots: Mapping[str, int]) -> None:
    """There is no other route: what reached a robot was counted."""
    with joined(robots, net=IPv4Network("10.99.3.0/24")) as link:
        routes = subprocess.run(link.at_desk("ip", "route"), capture_output=True, text=True, check=True)
        assert [line.split()[:3] for line in routes.stdout.splitlines()] == [["10.99.3.0/24", "dev", "wifi0"]]
        assert link.addresses == {"pi1": "10.99.3.11", "pi2": "10.99.3.12"}


def test_addresses_that_a_robot_uses_are_not_taken(robots: Mapping[str, int]) -> None:
    """Whichever of them it is."""
    on(robots["pi2"], "ip", "route", "add", "unreachable", "10.77.0.0/23")
    with joined(robots) as link:
        assert link.addresses["pi1"].startswith("10.77.2.")


TALK = """
import socket, sys
server = socket.create_server(("", 0))
print(server.getsockname()[1], flush=True)
near = server.accept()[0]
print(near.getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, 16).strip(b"\\0").decode())
"""

CHOOSE = """
import socket, sys
far = socket.create_connection((sys.argv[1], int(sys.argv[2])))
print(far.getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, 16).strip(b"\\0").decode())
far.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, b"cubic")
print(far.getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, 16).strip(b"\\0").decode())
"""


def test_tcp_behaves_as_asked_at_both_ends(robots: Mapping[str, int]) -> None:
    """And a program that chooses still gets what it chose."""
    listening = ("nsenter", "--target", str(robots["pi1"]), "--net", sys.executable, "-c", TALK)
    with (
        joined(robots, congestion="reno", quality=PERFECT) as link,
        subprocess.Popen(listening, stdout=-1, text=True) as listener,
    ):
        assert listener.stdout
        port = listener.stdout.readline().strip()
        chooser = link.at_desk(sys.executable, "-c", CHOOSE, link.addresses["pi1"], port)
        said = subprocess.run(chooser, capture_output=True, text=True, check=True).stdout
        assert (said.split(), listener.stdout.read().strip()) == (["reno", "cubic"], "reno")


def test_nothing_is_left(robots: Mapping[str, int]) -> None:
    """No namespace, no process and no device, also where what used the link failed."""
    before = children(os.getpid())
    with contextlib.suppress(ZeroDivisionError), joined(robots) as link:
        carriers = children(os.getpid()) - before
        there = (link.namespace in namespaces(), len(carriers), "wifi0" in links(robots))
        1 / 0  # noqa: B018
    assert there == (True, 1, True)
    assert (link.namespace in namespaces(), alive(carriers), "wifi0" in links(robots)) == (
        False,
        set(),
        False,
    )


def test_what_still_runs_at_the_desk_is_ended(robots: Mapping[str, int]) -> None:
    """Whoever waits there for a robot would wait for ever."""
    with joined(robots) as link:
        left = subprocess.Popen(link.at_desk("sleep", "600"))
        deadline = time.monotonic() + 10
        while not at_desk(link) and time.monotonic() < deadline:
            time.sleep(0.02)
    assert left.wait(10) == -signal.SIGKILL


def at_desk(link: Wifi) -> str:
    command = ("ip", "netns", "pids", link.namespace)
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_nothing_is_left_of_a_run_that_was_killed(robots: Mapping[str, int]) -> None:
    """The devices go with it, and the next link removes its desk."""
    script = f"import time\nfrom tests.support import wifi\nwith wifi.joined({robots!r}) as link:\n print(link.namespace, flush=True)\n time.sleep(60)"
    with subprocess.Popen((sys.executable, "-c", script), cwd=ROOT, stdout=-1, text=True) as killed:
        assert killed.stdout
        namespace = killed.stdout.readline().strip()
        carriers = children(killed.pid)
        killed.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 10
    while ("wifi0" in links(robots) or alive(carriers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert ("wifi0" in links(robots), alive(carriers)) == (False, set())
    with joined(robots):
        assert namespace not in namespaces()


def namespaces() -> list[str]:
    shown = subprocess.run(("ip", "netns", "list"), capture_output=True, text=True, check=True).stdout
    return [line.split()[0] for line in shown.splitlines()]


def links(robots: Mapping[str, int]) -> str:
    return "".join(on(pid, "ip", "link") for pid in robots.values())


def children(pid: int) -> set[str]:
    """The processes that a process has started, other test runs' not among them."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent = path.read_text().rpartition(")")[2].split()[:2]
            if state != "Z" and int(parent) == pid:
                found.add(path.parent.name)
    return found


def alive(pids: set[str]) -> set[str]:
    return {pid for pid in pids if Path("/proc", pid).exists()}


def test_without_root_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence, and nothing is made."""
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(RuntimeError, match="needs root"), joined({}):
        pass
