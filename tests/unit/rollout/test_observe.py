from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from fleet.errors import FleetError, Unreachable
from fleet.robot.facts import Facts
from fleet.robot.probe import LONGEST, MARK
from fleet.rollout import reconnect
from fleet.rollout.link import Link
from fleet.rollout.observe import keep_observing, observe, observe_one
from tests.support.homes import Home, Told, start
from tests.support.sshd import Sshds, free_port


@pytest.fixture
def home(sshds: Sshds) -> Home:
    return start(sshds, "pi1")


def test_observing_resumes_when_the_robot_is_back(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    """The connection is lost during the question: the question is repeated, and the person is told."""
    monkeypatch.setattr(reconnect, "_PAUSES", (0.1,))
    link, told = Link(home.robot), Told()
    link.session.close()
    assert observe_one(link, images=False, progress=told).fleet.stacks == {}
    link.close()
    assert told.said == [
        ("pi1", "the connection was lost before the command started; trying again for 3 min")
    ]


def test_a_robot_that_was_never_reached_is_told_at_once(home: Home) -> None:
    """It may be switched off, and the person waits for the answer."""
    home.server.stop()
    link, told = Link(home.robot), Told()
    with pytest.raises(Unreachable):
        observe_one(link, images=False, progress=told)
    assert told.said == []


def test_many_robots_are_observed(home: Home) -> None:
    """Facts, or the reason why they are missing, in the order of the robots."""
    away = home.robot.model_copy(update={"name": "pi2", "port": free_port()})
    seen = observe([away, home.robot], progress=Told())
    assert list(seen) == ["pi2", "pi1"]
    assert isinstance(seen["pi1"], Facts)
    assert isinstance(seen["pi2"], FleetError)


def test_watching_follows_what_changes_and_survives_a_robot_that_goes(home: Home) -> None:
    """Over one connection, until Ctrl-C; a robot that goes away is seen to be away."""
    seen: dict[str, Facts | FleetError] = {}

    def releases() -> tuple[str, ...] | None:
        now = seen.get("pi1")
        return tuple(now.fleet.stacks) if isinstance(now, Facts) else None

    def person() -> None:
        def until(what: object) -> None:
            end = time.monotonic() + 20
            while releases() != what and time.monotonic() < end:
                time.sleep(0.01)

        until(())
        (home.path / ".fleet/stacks/abc").mkdir(parents=True)
        until(("abc",))
        told.append(home.logins)
        home.server.stop()
        until(None)
        told.append(releases())
        os.kill(os.getpid(), signal.SIGINT)

    told: list[object] = []
    thread = threading.Thread(target=person)
    thread.start()
    keep_observing([home.robot], seen, every=0.05, progress=Told())
    thread.join()
    assert told == [1, None]


LIARS = """
import sys
from pathlib import Path
from fleet.config.inventory import Robot
from fleet.rollout.observe import observe
from fleet.rollout.progress import NoProgress
port, user, key, known = sys.argv[1:]
robots = [
    Robot(name=f"pi{number}", address="127.0.0.1", port=int(port), user=user, identity_file=Path(key), known_hosts=Path(known))
    for number in range(32)
]
seen = observe(robots, progress=NoProgress())
status = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
peak = int(status["VmHWM"].split()[0]) // 1024  # of this program alone: ru_maxrss begins with the parent's
print(len({type(what).__name__ for what in seen.values()}), peak)
"""


@pytest.mark.parametrize(
    "lie",
    [
        "exec yes",
        "exec yes >&2",
        "exec cat /dev/zero",
        "cat answer",
    ],
)
def test_32_liars_at_once_are_no_matter(sshds: Sshds, lie: str) -> None:
    """They print without end, or as much as is read of them: in letters that need much memory, of stacks and containers."""
    lines = "".join(f"stack s{number}\nevent {chr(0x1F600)}{'x' * 900}\n" for number in range(190))
    text = f"\n{MARK} stacks\n{lines}" + "event x\n" * 40_000
    text += f"\n{MARK} daemon\n{chr(0x1F600) * ((LONGEST - len(text.encode()) - 100) // 4)}\n{MARK} end\n"
    (sshds.folder / "answer").write_text(text)
    server = sshds.start(options=(f"ForceCommand cd {sshds.folder} && {lie}",))
    robot = server.robot()
    words = (str(robot.port), str(robot.user), str(robot.identity_file), str(robot.known_hosts))
    done = subprocess.run(
        (sys.executable, "-c", LIARS, *words), capture_output=True, text=True, check=True, timeout=120
    )
    kinds, megabytes = map(int, done.stdout.split())
    assert kinds == 1
    assert megabytes < 300
