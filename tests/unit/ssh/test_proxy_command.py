from __future__ import annotations

import time
from pathlib import Path

import pytest

from fleet.ssh.proxy_command import ProxySocket


def test_bytes_go_both_ways() -> None:
    """It is a socket to whoever uses it."""
    with ProxySocket("cat") as sock:
        sock.sendall(b"hello")
        assert sock.recv(100) == b"hello"


def test_the_end_of_the_command_is_the_end_of_the_stream() -> None:
    """Paramiko's own class never says so."""
    with ProxySocket("echo once") as sock:
        assert sock.recv(100) == b"once\n"
        assert sock.recv(100) == b""


def test_closing_ends_the_command_and_all_it_started() -> None:
    """Also one that does not look at its input; closing twice is closing."""
    sock = ProxySocket("sh -c 'echo $$; sleep 60 & echo $!; sleep 60'")
    text = b""
    while text.count(b"\n") < 2:
        text += sock.recv(100)
    sock.close()
    sock.close()
    for pid in map(int, text.split()):
        deadline = time.monotonic() + 5
        while alive(pid) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not alive(pid)


def alive(pid: int) -> bool:
    """Whether it runs; one that nobody has buried yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("sh -c 'echo first >&2; echo the reason >&2; exit 1'", "the reason"),
        ("sh -c 'exit 1'", ""),
        ("sh -c 'seq 100000 >&2'", "100000"),
        ("/no/such/command", "/no/such/command"),
    ],
)
def test_its_last_words_are_kept(command: str, said: str) -> None:
    """They are the reason that a person is told, however much it said before."""
    sock = ProxySocket(command)
    while sock.recv(1 << 16):
        pass
    sock.close()
    assert said in sock.last_error
    assert bool(said) == bool(sock.last_error)


def test_it_has_no_terminal_to_ask() -> None:
    """An inner ssh that wants a password must fail, not wait."""
    with ProxySocket("sh -c '(echo x >/dev/tty) 2>/dev/null && echo terminal || echo none'") as sock:
        assert sock.recv(100) == b"none\n"
