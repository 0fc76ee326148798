"""How does a robot look over Wi-Fi? A link with a rate, a delay and losses, between a desk and virtual Pis.

The desk is a network namespace of its own that has nothing but this link: a command that runs there reaches a robot
over the air or not at all, and still speaks to this computer's Docker through its socket. The kernel need not know how
to emulate links (netem): a process (`wifiair`) carries the packets between TUN devices. Needs root.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import secrets
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
from dataclasses import asdict, dataclass
from ipaddress import IPv4Network
from pathlib import Path
from typing import TYPE_CHECKING

from tests.support import wifi_air as wifiair

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

NETS = IPv4Network("10.77.0.0/16")
"""Where a link's addresses come from: the first /24 of it that neither this computer nor a robot has a route to."""

DEVICE = "wifi0"
PREFIX = "fleetwifi"
SEGMENT = 52  # bytes of IP and TCP in a packet, with time stamps
TUNNELS = Path("/dev/net/tun")

_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
_ANSWERS_IN = 10.0


@dataclass(frozen=True, kw_only=True)
class Quality:
    """How good a link is: Mbit/s each way, milliseconds there and back (least, most), and the share of packets lost.

    A packet that would wait longer than ``queue`` milliseconds for its turn is dropped.
    """

    rate: float = 20.0
    round_trip: tuple[float, float] = (5.0, 20.0)
    loss: float = 0.01
    queue: float = 150.0


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """What one robot's link carried since it was made: ``to`` the robot and ``back``."""

    to: wifiair.Counted
    back: wifiair.Counted

    @property
    def bytes(self) -> int:
        """All bytes that went on the air, in packets with their headers, both ways, those nobody heard too."""
        return self.to.sent_bytes + self.back.sent_bytes

    @property
    def payload(self) -> int:
        """What reached the robot inside TCP; bytes that were sent again and arrived twice count twice."""
        to = self.to
        return to.sent_bytes - to.lost_bytes - SEGMENT * (to.sent - to.lost)


class Wifi:
    """A link that is there: `joined` makes it."""

    def __init__(self, *, namespace: str, addresses: Mapping[str, str], control: socket.socket) -> None:
        self.namespace = namespace
        self.addresses = addresses
        self._control = control
        self._turn = threading.Lock()

    def at_desk(self, *argv: str) -> tuple[str, ...]:
        """The command that runs a command at the desk."""
        return ("ip", "netns", "exec", self.namespace, *argv)

    def traffic(self, robot: str) -> Traffic:
        """What its link carried until now."""
        counted = self._ask({})[robot]
        return Traffic(to=wifiair.Counted(**counted["to"]), back=wifiair.Counted(**counted["back"]))

    def change(self, quality: Quality, *robots: str) -> None:
        """Make links better or worse; all of them where none is named."""
        self._ask({"robots": robots or tuple(self.addresses), "change": asdict(quality)})

    def cut(self, seconds: float, *robots: str) -> None:
        """Let nothing through for so long, not even what is on its way; 0 ends an outage."""
        self._ask({"robots": robots or tuple(self.addresses), "change": {"outage": seconds}})

    def _ask(self, what: Mapping[str, object]) -> dict[str, dict[str, dict[str, int]]]:
        with self._turn:
            return _exchange(self._control, what)


@contextlib.contextmanager
def joined(
    robots: Mapping[str, int],
    *,
    quality: Quality | None = None,
    air: float = 0.0,
    congestion: str | None = "cubic",
    net: IPv4Network | None = None,
    seed: int = 1,
) -> Iterator[Wifi]:
    """A new desk, and robots on its Wi-Fi; all gone at the end. A robot is a process id in its network namespace.

    With ``air`` all links share so many Mbit/s. ``congestion`` is what TCP does at both ends where a program does not
    choose once it is connected; None leaves it as it is. Raises ``RuntimeError`` with the reason where this computer cannot.
    """
    _check()
    _sweep()
    net = net or _free_net(tuple(robots.values()))
    addresses = {name: str(net[11 + number]) for number, name in enumerate(robots)}
    namespace = f"{PREFIX}-{os.getpid()}-{secrets.token_hex(3)}"
    _run("ip", "netns", "add", namespace)
    with contextlib.ExitStack() as stack:
        stack.callback(_run, "ip", "netns", "delete", namespace)
        stack.callback(_clear, namespace)
        inside = ("ip", "netns", "exec", namespace)
        _run(*inside, "ip", "link", "set", "lo", "up")
        desk = _device(stack, namespace, inside, f"{net[1]}/{net.prefixlen}")
        devices = {
            name: _device(stack, str(pid), _enter(pid), f"{addresses[name]}/{net.prefixlen}")
            for name, pid in robots.items()
        }
        if congestion:
            for where in (inside, *map(_enter, robots.values())):
                # On the route, not as the namespace's default: that may only be what any user may choose.
                _run(*where, "ip", "route", "change", str(net), "dev", DEVICE, "congctl", congestion)
        start = {"desk": desk, "devices": devices, "addresses": addresses, "air": air, "seed": seed}
        control = _carrier(stack, {**start, "quality": asdict(quality or Quality())})
        yield Wifi(namespace=namespace, addresses=addresses, control=control)


def _clear(namespace: str) -> None:
    """End what still runs at the desk: nothing would ever answer it."""
    for pid in _run("ip", "netns", "pids", namespace).split():
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(pid), signal.SIGKILL)


def why_not() -> str:
    """Why this computer cannot have such a link, "" where it can."""
    if os.geteuid():
        return "an emulated Wi-Fi needs root: it makes network namespaces and TUN devices"
    if not TUNNELS.exists():
        return f"an emulated Wi-Fi needs TUN devices, and there is no {TUNNELS}"
    missing = [tool for tool in ("ip", "nsenter") if shutil.which(tool) is None]
    return f"an emulated Wi-Fi needs {' and '.join(missing)}" if missing else ""


def _check() -> None:
    if reason := why_not():
        raise RuntimeError(reason)


def _sweep() -> None:
    """Remove the desks of runs that were killed."""
    for name in re.findall(rf"^{PREFIX}-\d+-\w+", _run("ip", "netns", "list"), re.MULTILINE):
        if not Path(f"/proc/{name.split('-')[1]}").exists():
            _run("ip", "netns", "delete", name)


def _free_net(pids: Sequence[int]) -> IPv4Network:
    shown = "\n".join(_run(*where, "ip", "-4", "route") for where in ((), *map(_enter, pids)))
    taken = [IPv4Network(found) for found in re.findall(r"^(?:[a-z]+ )?(\d[\d./]+) ", shown, re.MULTILINE)]
    free = (net for net in NETS.subnets(new_prefix=24) if not any(net.overlaps(other) for other in taken))
    try:
        return next(free)
    except StopIteration:
        raise RuntimeError(f"no part of {NETS} is free for an emulated Wi-Fi") from None


def _enter(pid: int) -> tuple[str, ...]:
    return ("nsenter", "--target", str(pid), "--net")


def _device(stack: contextlib.ExitStack, namespace: str, inside: Sequence[str], address: str) -> int:
    """A TUN device in a namespace, up, with this address; what this process holds of it."""
    device = os.open(TUNNELS, os.O_RDWR | os.O_NONBLOCK)
    stack.callback(os.close, device)
    asked = struct.pack("16sH22x", f"{PREFIX}%d".encode(), _IFF_TUN | _IFF_NO_PI)
    name = fcntl.ioctl(device, _TUNSETIFF, asked)[:16].rstrip(b"\0").decode()
    _run("ip", "link", "set", name, "netns", namespace, "name", DEVICE)
    _run(*inside, "ip", "address", "add", address, "dev", DEVICE)
    _run(*inside, "ip", "link", "set", DEVICE, "up")
    return device


def _carrier(stack: contextlib.ExitStack, start: Mapping[str, object]) -> socket.socket:
    """Start the process that carries packets; the socket it listens to. It ends when that is closed, however that is."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    devices: dict[str, int] = start["devices"]  # type: ignore[assignment]
    inherited = (theirs.fileno(), start["desk"], *devices.values())
    process = subprocess.Popen(
        (sys.executable, str(Path(wifiair.__file__)), str(theirs.fileno())),
        pass_fds=inherited,  # type: ignore[arg-type]
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        # Ctrl-C ends the run, and the run ends this.
        start_new_session=True,
    )
    stack.callback(_end, process, ours)
    theirs.close()
    ours.settimeout(_ANSWERS_IN)
    _exchange(ours, start)
    return ours


def _end(process: subprocess.Popen[bytes], control: socket.socket) -> None:
    control.close()
    try:
        process.wait(_ANSWERS_IN)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _exchange(control: socket.socket, message: Mapping[str, object]) -> dict[str, dict[str, dict[str, int]]]:
    control.send(json.dumps(message).encode())
    answer: dict[str, dict[str, dict[str, int]]] = json.loads(control.recv(wifiair.LARGEST) or "null")
    if answer is None:
        raise RuntimeError("the emulated Wi-Fi ended by itself")
    return answer


def _run(*argv: str) -> str:
    done = subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(argv)} failed: {done.stderr.strip()}")
    return done.stdout
