"""The benchmark's own parts, and its goals in short and generously: ratios and memory, never seconds on the clock."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bench import asking, report, resolving
from bench.pairs import ROOT, Cost, Pairs, compare, cpu_per_gigabyte, spend
from bench.report import Row

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tests.support.sshd import Sshd, Sshds

SINK = ("sh", "-c", "cat > /dev/null")


def pairs(*seconds: tuple[float, float]) -> Pairs:
    return Pairs(
        fleet=tuple(Cost(seconds=ours, cpu=0) for ours, _ in seconds),
        usual=tuple(Cost(seconds=theirs, cpu=0) for _, theirs in seconds),
    )


@pytest.fixture
def environment() -> Mapping[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def test_two_ways_are_compared_pair_by_pair() -> None:
    """A minute in which everything is slow slows both ways, and leaves the ratio."""
    assert pairs((1, 1), (12, 10), (3, 2)).ratio == pytest.approx(1.2)


def test_two_ways_take_turns() -> None:
    """A, B, A, B: what changes while measuring is spread over both."""
    order: list[str] = []

    def way(name: str) -> Cost:
        order.append(name)
        return Cost(seconds=1, cpu=1)

    compare(lambda: way("fleet"), lambda: way("usual"), rounds=2)
    assert order == ["fleet", "usual", "fleet", "usual"]


def test_a_slow_computer_is_measured_twice_at_least() -> None:
    """When the time is used up no round begins, and one alone would be no median."""
    once = Cost(seconds=1, cpu=1)
    assert len(compare(lambda: once, lambda: once, rounds=5, within=0).ratios) == 2


def test_cpu_is_told_for_a_gigabyte() -> None:
    """The figure does not depend on how much was sent."""
    runs = [Cost(seconds=9, cpu=cpu, sent=500_000_000) for cpu in (1, 2, 3)]
    assert cpu_per_gigabyte(runs) == pytest.approx(4)


@pytest.mark.parametrize(("value", "verdict"), [(1.1, "yes"), (1.11, "NO")])
def test_a_row_says_whether_its_goal_is_met(value: float, verdict: str) -> None:
    """The goal itself still counts as met."""
    row = Row(what="it", value=value, goal=1.1, unit="x", how="")
    assert (row.met, row.cells()[1:4]) == (verdict == "yes", (f"{value:.2f}x", "at most 1.10x", verdict))


def test_the_page_has_every_row_and_where_it_was_measured() -> None:
    """What nobody can place or repeat is no figure."""
    rows = (
        report.ratio("streaming", pairs((2, 2), (2, 1), (3, 2)), goal=1.1),
        Row(what="memory", value=65, goal=None, unit="MB", how="peak"),
    )
    page = report.page(rows, when="2026-01-02 03:04 UTC", machine="The computer: 2 cores.")
    assert "| streaming | 1.50x | at most 1.10x | NO | 2.00 s and 2.00 s; 3 pairs, 1.00x to 2.00x |" in page
    assert "| memory | 65 MB |  |  | peak |" in page
    assert "`make bench` on 2026-01-02 03:04 UTC; do not edit. The computer: 2 cores." in page


def test_a_measured_command_that_fails_is_no_measurement(environment: Mapping[str, str]) -> None:
    """A way that fails early would be the fastest."""
    with pytest.raises(RuntimeError, match="code 3: no such thing"):
        spend(("sh", "-c", "echo no such thing >&2; exit 3"), environment=environment)


def test_a_measured_command_that_takes_too_long_is_ended_with_all_it_started(
    environment: Mapping[str, str], tmp_path: Path
) -> None:
    """No pipe of a run that was given up goes on sending."""
    started = tmp_path / "started"
    with pytest.raises(RuntimeError, match="longer than 2 s"):
        spend(("sh", "-c", f"sleep 100 & echo $! > {started}; wait"), environment=environment, limit=2)
    state = Path(f"/proc/{started.read_text().strip()}/stat")
    assert not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z"


def test_memory_stays_flat_with_several_robots(sshds: Sshds, environment: Mapping[str, str]) -> None:
    """Three robots at once take three times 128 MB; the process that feeds them stays under 200 MB."""
    robots = sshds.start_many(3)
    cost = send(robots, megabytes=128, environment=environment)
    assert cost.sent == 3 * 128 << 20
    assert cost.peak < 200_000_000


def test_streaming_costs_about_as_much_as_with_openssh(sshd: Sshd, environment: Mapping[str, str]) -> None:
    """Less than twice the CPU; `make bench` measures exactly, and asks for much less."""
    megabytes = 256
    options = ("-F", "none", "-o", f"UserKnownHostsFile={sshd.known_hosts}", "-p", str(sshd.port))
    ssh = f"ssh {' '.join(options)} -i {sshd.identity} {sshd.address} 'cat > /dev/null'"

    def openssh() -> Cost:
        line = f"head -c {megabytes}M /dev/zero | {ssh}"
        return spend(("sh", "-c", line), environment=environment)[0]

    both = compare(lambda: send((sshd,), megabytes=megabytes, environment=environment), openssh, rounds=2)
    assert min(ours.cpu / theirs.cpu for ours, theirs in zip(both.fleet, both.usual, strict=True)) < 2


@pytest.mark.usefixtures("desktop")
def test_asking_many_robots_takes_little_longer_than_a_bare_pool(
    tmp_path: Path, environment: Mapping[str, str]
) -> None:
    """Less than three times as long over a few robots, where Python's start is most of it."""
    with asking.servers(8, folder=tmp_path, environment=environment) as servers:
        assert min(servers.compare(rounds=2).ratios) < 3


@pytest.mark.usefixtures("desktop")
def test_twenty_robots_are_read_together(environment: Mapping[str, str], tmp_path: Path) -> None:
    """Compose runs once for each set of values, side by side: twenty cost nowhere near twenty times one."""
    one, twenty = resolving.rows((1, 20), folder=tmp_path, environment=environment, rounds=1)
    assert (one.goal, "20 robots" in twenty.what) == (None, True)
    assert twenty.value < 5 * one.value


def test_the_list_of_verbs_needs_no_slow_library(environment: Mapping[str, str]) -> None:
    """`fab --list` imports all tasks, and none of the libraries that only some verbs need."""
    code = "import sys, fleet.cli; print(*({'pydantic', 'docker', 'requests'} & sys.modules.keys()))"
    assert spend((sys.executable, "-c", code), environment=environment)[1].strip() == ""


def send(robots: tuple[Sshd, ...], *, megabytes: int, environment: Mapping[str, str]) -> Cost:
    """Filler instead of an image, with fleet's own sender."""
    listed = {
        one.name: {"address": one.address, "port": one.port, "user": one.robot().user} for one in robots
    }
    first = robots[0]
    whole = {
        "known_hosts": str(first.known_hosts),
        "defaults": {"identity_file": str(first.identity)},
        "robots": listed,
    }
    inventory = first.known_hosts.with_name("inventory.yaml")
    inventory.write_text(json.dumps(whole), encoding="utf-8")
    what = ("--inventory", str(inventory), "--megabytes", str(megabytes))
    command = (sys.executable, "-m", "bench.sender", *what, "--", *SINK)
    return Cost(**json.loads(spend(command, environment=environment)[1]))
