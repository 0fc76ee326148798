from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import time
from typing import TYPE_CHECKING

from tests.support.project import FAB

if TYPE_CHECKING:
    from tests.support.project import Project


def test_a_command_on_all_robots(mine: Project) -> None:
    """Lines with names on standard output, what went wrong on standard error."""
    done = mine.fab("run", "--", "pwd")
    assert sorted(done.out.splitlines()) == [f"{n}  | {mine.robots[n].path}" for n in ("pi1", "pi2")]
    assert done.err.startswith("away: 127.0.0.1 refuses connections to port ")
    assert done.code == 1


def test_a_dry_run_of_a_command_shows_it(mine: Project) -> None:
    """On each robot that would run it."""
    assert (
        mine.fleet("run", "--dry", "--hosts", "fleet", "--", "reboot").out == "pi1: $ reboot\npi2: $ reboot\n"
    )


def test_status_of_robots_to_which_nothing_was_shipped(mine: Project) -> None:
    """A row each; the one that is away makes the code 1, the others do not."""
    done = mine.fleet("status")
    rows = [line.split() for line in done.out.splitlines()]
    assert rows[0][:4] == ["robot", "reachable", "stack", "release"]
    assert [row[:2] for row in rows[1:]] == [["pi1", "yes"], ["pi2", "yes"], ["away", "no"]]
    assert done.code == 1
    assert done.err == "3 robots: 2 well, 1 not reachable\n"
    assert mine.fleet("status", "--hosts", "fleet").code == 0


def test_a_fleet_that_is_half_away_answers_early(own: Project) -> None:
    """Forty robots accept a connection and say nothing: the one that is there is shown before they are given up."""
    with contextlib.ExitStack() as holes:
        ports = [
            holes.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1] for _ in range(40)
        ]
        inventory = own.folder / "inventory.yaml"
        away = "".join(
            f"  hole{number}: {{address: 127.0.0.1, port: {port}}}\n" for number, port in enumerate(ports)
        )
        inventory.write_text(inventory.read_text().replace("robots:\n", f"robots:\n{away}"))
        began = time.monotonic()
        process = subprocess.Popen(
            (str(FAB), "status"),
            cwd=own.folder,
            env=own.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        rows = [(time.monotonic() - began, line.split()) for line in process.stdout]
        err = process.communicate()[1]
    assert [row[:2] for _, row in rows[:2]] == [["robot", "reachable"], ["pi1", "yes"]]
    assert rows[1][0] < rows[2][0] - 2  # they are waited for eight seconds
    assert rows[-1][0] < 25  # thirteen; in turns of 32 it would be more than twenty
    assert {row[1] for _, row in rows[2:]} == {"no"}
    assert (len(rows), process.returncode) == (43, 1)
    assert err == "42 robots: 1 well, 41 not reachable\n"


def test_the_inventory_of_a_robot_with_ros_2(own: Project) -> None:
    """Its settings and its peers' addresses; nothing about a ROS master, which ROS 2 does not have."""
    (own.folder / "inventory.yaml").write_text(
        "defaults: {ros: {version: 2, domain: 7, peers: [all]}}\nrobots: {pi1: 10.0.0.1, pi2: 10.0.0.2}\n"
    )
    words = own.fleet("inventory", "--hosts", "pi1").out
    assert "  ros.domain               7\n" in words
    assert "10.0.0.2" in words
    assert "master" not in words
    assert json.loads(own.fleet("inventory", "--json").out)[0]["peers"] == ["10.0.0.2"]


def test_history_is_told_by_robot_and_time(own: Project) -> None:
    """The last so many of each; 0 is none."""
    home = own.robots["pi1"].path
    (home / ".fleet/stacks/tiny").mkdir(parents=True)
    lines = [f"2026-11-23T12:0{number}:00Z\tship\tr{number}\ttim@desktop\tdone" for number in range(5)]
    (home / ".fleet/stacks/tiny/history").write_text("\n".join(lines) + "\n")
    done = own.fleet("history", "--hosts", "pi1", "--tail", "2")
    assert [line.split() for line in done.out.splitlines()[1:]] == [
        ["pi1", "tiny", "2026-11-23", f"12:0{number}:00", "ship", f"r{number}", "tim@desktop", "done"]
        for number in (3, 4)
    ]
    assert len(json.loads(own.fleet("history", "--hosts", "pi1", "--json").out)["pi1"]) == 5
    assert len(own.fleet("history", "--hosts", "pi1", "--tail", "0").out.splitlines()) == 1


def test_a_shell_is_openssh_with_the_recorded_keys(own: Project) -> None:
    """The very words, and they lead in; an unknown robot is refused by OpenSSH too."""
    words = own.fab("shell", "--hosts", "pi1", "--dry").out
    assert words.startswith("ssh ")
    assert str(own.folder / "known_hosts") in words
    assert "StrictHostKeyChecking=yes" in words
    done = subprocess.run(
        (str(FAB), "shell", "--hosts", "pi1"),
        cwd=own.folder,
        env=own.environment,
        input="",
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, "Accepted" in own.robots["pi1"].server.log.read_text()) == (0, True)
    (own.folder / "known_hosts").unlink()
    assert own.fab("shell", "--hosts", "pi1").code == 255


def test_a_live_status_goes_on_until_ctrl_c(own: Project) -> None:
    """It draws the table again and again, and ends well."""
    home = own.robots["pi1"]
    process = subprocess.Popen(
        (str(FAB), "status", "--watch", "--hosts", "pi1"),
        cwd=own.folder,
        env=own.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 30
    while home.logins < 1:
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(3)  # it answers, and is looked at once more
    process.send_signal(2)
    out, err = process.communicate(timeout=15)
    assert (process.returncode, err) == (0, "")
    assert "pi1" in out


def test_the_inventory_with_what_robots_say(mine: Project) -> None:
    """Facts of those that answer; the one that is away is told, and makes the code 1."""
    done = mine.fleet("inventory", "--facts")
    assert done.out.count("  facts.machine ") == 2
    assert "away: " in done.err
    assert done.code == 1
    told = {one["name"]: one["facts"] for one in json.loads(mine.fleet("inventory", "--facts", "--json").out)}
    assert [told[name]["reachable"] for name in ("pi1", "pi2", "away")] == [True, True, False]
    assert told["pi1"]["host"]["machine"]
