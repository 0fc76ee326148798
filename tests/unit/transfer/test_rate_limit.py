from __future__ import annotations

import threading
import time

import pytest

from fleet.errors import UsageError
from fleet.transfer.rate_limit import BURST, RateLimiter, bytes_per_second


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("", None),
        ("8Mbit", 1e6),
        ("8mbit/s", 1e6),
        ("8Mbitps", 1e6),
        ("1MB", 1e6),
        ("1 MB/s", 1e6),
        (" 1.5mb ", 1.5e6),
        ("1000kbit", 125_000.0),
        ("1Gbit", 1.25e8),
        ("500kB", 5e5),
        ("8kbit", 1000.0),
    ],
)
def test_rates_as_people_write_them(text: str, rate: float | None) -> None:
    """In bits, as links are sold, or in bytes; nothing is no limit."""
    assert bytes_per_second(text) == rate


@pytest.mark.parametrize(
    "text", ["8", "fast", "8Mbps", "-1MB", "0MB", "7kbit", "1e6MB", "1GB", "1,5MB", "1.MB", "MB"]
)
def test_what_is_not_a_rate_is_refused(text: str) -> None:
    """With how it is written: Mbps are bits to most, and a rate that would take days is a slip."""
    with pytest.raises(UsageError) as caught:
        bytes_per_second(text)
    assert caught.value.what == f"--limit {text} is not a rate"
    assert caught.value.cure == "write it as 8Mbit (bits) or 1MB (bytes) per second"


class Interrupted(float):
    """A number at whose use other threads have their turn, as they may anywhere."""

    def __rtruediv__(self, other: float) -> float:
        time.sleep(0.001)
        return other / float(self)


def test_several_share_one_rate() -> None:
    """Together they send as fast as one may, and each has its turn."""
    rate, each, threads = 1_000_000, 5000, 4
    limiter, counts = RateLimiter(Interrupted(rate)), [0] * threads
    until = time.monotonic() + 0.5

    def send(number: int) -> None:
        while time.monotonic() < until:
            limiter.acquire(each)
            counts[number] += each

    running = [threading.Thread(target=send, args=(number,)) for number in range(threads)]
    began = time.monotonic()
    for thread in running:
        thread.start()
    for thread in running:
        thread.join()
    took = time.monotonic() - began
    assert sum(counts) <= rate * (took + BURST) * 1.1
    assert sum(counts) >= rate * 0.5 * 0.9
    assert min(counts) > 0


def test_a_pause_is_not_caught_up_with() -> None:
    """What was not used is gone: after a second of silence there is no second of noise."""
    limiter = RateLimiter(100_000)
    limiter.acquire(1)
    time.sleep(0.4)
    began = time.monotonic()
    for _ in range(4):
        limiter.acquire(10_000)
    assert time.monotonic() - began >= 0.2 - 0.02


def test_without_a_limit_no_transfer_waits() -> None:
    """Not even for very much."""
    began = time.monotonic()
    RateLimiter(None).acquire(10**15)
    assert time.monotonic() - began < 1
