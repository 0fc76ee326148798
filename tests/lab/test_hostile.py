"""Links that swallow everything, full disks, robots that lie, inventories meant to harm: an answer in bounded time, and nothing lost."""

from __future__ import annotations

import os
import random
import time
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING

import pytest
import yaml

from fleet.config import inventory
from fleet.errors import FleetError
from tests.support.lab_project import HEAVY, current, cut, environment, eventually, running, service, wipe
from tests.support.swap_state import note

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.lab.conftest import Pi
    from tests.support.lab_project import Project, Running, Said

TIMES = int(os.environ.get("FLEET_FAULTS", "1"))
"""How often each kind is injected. `make test-faults` sets more."""

SEED = int(os.environ.get("FLEET_SEED", "28"))

VERBS = {
    "trust": ("--yes",),
    "provision": (),
    "status": (),
    "history": (),
    "logs": (),
    "run": ("--", "true"),
    "start": (),
    "restart": (),
    "stop": (),
    "rollback": (),
    "prune": (),
    "ship": ("--retry-for", "0"),
    "remove": ("--stack", "tiny", "--yes"),
    "topics": (),
    "listen": ("--topic", "/time", "--count", "1"),
}
"""Verbs that go to robots, with what else they need."""


def words(verb: str, more: tuple[str, ...], robot: str) -> tuple[str, ...]:
    return (verb, "--hosts", robot, *more)


def finished(commands: dict[str, Running], *, within: float) -> dict[str, Said]:
    """The end of each command; the one that takes longer than all may (seconds) is named."""
    deadline = time.monotonic() + within
    ends = {}
    for name, fab in commands.items():
        try:
            ends[name] = fab.end(within=max(1, deadline - time.monotonic()))
        except AssertionError as error:
            pytest.fail(f"{name}: {error}", pytrace=False)
    return ends


def test_black_holes_by_verb(
    project: Project, pi: Pi, record_property: Callable[[str, object], None]
) -> None:
    """A robot that swallows all bytes from the beginning is named by each verb within a minute, and is as it was."""
    project.well("ship", "--hosts", pi.name)
    before = running(pi), current(pi)
    rounds = max(1, TIMES // 10)
    for _ in range(rounds):
        with ExitStack() as stack:
            stack.enter_context(cut(pi))
            commands = {
                verb: stack.enter_context(project.start(*words(verb, more, pi.name)))
                for verb, more in VERBS.items()
            }
            for verb, said in finished(commands, within=60).items():
                assert (said.code, "Traceback" in said.all) == (1, False), (verb, said)
                assert pi.name in said.all, (verb, said)
    assert (running(pi), current(pi)) == before
    note(
        record_property,
        fault=f"a robot that swallows all bytes, for each of {len(VERBS)} verbs",
        times=rounds * len(VERBS),
        end="named within 60 s, exit code 1; the robot as before",
    )


def test_links_that_fall_silent(
    project: Project, pi: Pi, record_property: Callable[[str, object], None]
) -> None:
    """In the middle of two commands, for 5 to 40 s: they end or go on when the link is back, and one release runs."""
    chance = random.Random(f"{SEED} silent")  # noqa: S311  not for secrets
    project.well("ship", "--hosts", pi.name)
    times = max(1, TIMES // 2)
    changing = ["ship", "restart", "rollback", "prune", "start"]
    for number in range(1, times + 1):
        project.colour(str(number))
        verb = chance.choice(changing)
        moment = chance.uniform(0, 4)
        with ExitStack() as stack:
            commands = {
                "run": stack.enter_context(project.start(*words("run", ("--", "sleep", "20"), pi.name)))
            }
            commands[verb] = stack.enter_context(project.start(*words(verb, VERBS[verb], pi.name)))
            time.sleep(moment)
            with cut(pi):
                time.sleep(chance.uniform(5, 40))
            ends = finished(commands, within=120)
        where = f"{verb}, silent after {moment:.2f} s (seed {SEED})"
        assert all("Traceback" not in said.all for said in ends.values()), (where, ends)
        again = project.fab("ship", "--hosts", pi.name, within=180)
        assert again.code == 0, (where, again)
        assert eventually(lambda: running(pi).get("tick", ("", ""))[1] == current(pi)), where
        assert environment(pi)["COLOUR"] == str(number), where
    note(
        record_property,
        fault="a link that falls silent for 5 to 40 s in two commands at once",
        times=times,
        end="both ended within two minutes of its return; the next ship was done",
    )


@contextmanager
def small(pi: Pi, place: str, *, size: int) -> Iterator[None]:
    """A folder of a robot on a file system of so many bytes; what was in it is there again afterwards."""
    pi.exec("sh", "-c", f"mkdir -p {place}; chown --reference=/home/pi {place}")
    owner = pi.exec("sh", "-c", f"stat -c uid=%u,gid=%g,mode=%a {place}")
    pi.exec("sh", "-c", f"mount -t tmpfs -o size={size},{owner} tmpfs {place}")
    try:
        yield
    finally:
        pi.exec("sh", "-c", f"umount {place}")


FOLDERS = (
    "/home/pi/.fleet/spool",
    "/home/pi/.fleet/stacks/tiny/releases",
    "/var/lib/docker/tmp",
    "/home/pi/.fleet/runs",
)


def test_full_disks(project: Project, pi: Pi, record_property: Callable[[str, object], None]) -> None:
    """Wherever bytes end up: one sentence, what ran runs on, and the next ship sends the rest."""
    chance = random.Random(f"{SEED} full")  # noqa: S311  not for secrets
    for number in range(1, TIMES + 1):
        wipe(pi)
        project.stack(tick=service())
        project.well("ship", "--hosts", pi.name)
        place = FOLDERS[number % len(FOLDERS)]
        size = chance.choice((4096, chance.randrange(4096, 65_536), chance.randrange(65_536, 30_000_000)))
        where = f"{place} of {size} bytes (seed {SEED})"
        before = running(pi), current(pi)
        project.stack(tick=service(HEAVY))
        project.colour(f"{number}")
        with small(pi, place, size=size):
            said = project.fab("ship", "--hosts", pi.name, "--json", within=180)
        (outcome,) = said.json
        if said.code == 0:
            assert running(pi)["tick"][1] == current(pi) != before[1], where
        else:
            assert said.code in {1, 2}, (where, said)
            assert (running(pi), current(pi)) == before, (where, said)
            assert any(word in outcome["reason"] for word in ("disk", "room", "space")), (where, said)
            assert outcome["cure"], (where, said)
        again = project.fab("ship", "--hosts", pi.name, within=180)
        assert again.code == 0, (where, again)
        assert running(pi)["tick"][1] == current(pi), where
    note(
        record_property,
        fault="a full disk, in the spool, the releases, Docker, or the runs",
        times=TIMES,
        end="a sentence; the release before ran on; the next ship was done",
    )


LIES = (
    "printf '['; head -c 200000 /dev/zero | tr '\\0' '['",
    'printf \'{"Labels": null, "Names": 7, "State": ["x"], "Status": null}\\n\'',
    "printf '\\377\\376\\000 \\342\\200\\256 \\302\\233\\n'",
    "head -c 6000 /dev/zero | tr '\\0' '9'",
    "echo 1e999999999",
    "exec yes",
    "exec yes >&2",
    "exec cat /dev/zero",
    "printf null",
    "printf '{}'",
    ":",
    "echo 'permission denied' >&2; exit 1",
    "kill -SEGV $$",
    "exec sleep 3600",
)
ASKED = ("version", "info", "ps", "inspect", "image", "compose", "load", "")
"""Which of Docker's commands are answered with a lie; the last is all of them."""

LIAR = """#!/bin/sh
case " $* " in *" {word}"*) {lie}; exit ;; esac
exec /usr/bin/docker "$@"
"""


@contextmanager
def lying(pi: Pi, *, word: str, lie: str) -> Iterator[None]:
    """Have a robot's `docker` answer nonsense for a while."""
    path = "/usr/local/bin/docker"
    pi.exec("sh", "-c", 'printf %s "$1" > "$2"; chmod 755 "$2"', "-", LIAR.format(word=word, lie=lie), path)
    try:
        yield
    finally:
        pi.exec(
            "sh",
            "-c",
            f"rm -f {path}; pkill -x yes; pkill -f '[s]leep 3600'; pkill -f '[c]at /dev/zero'; true",
        )


def test_liars(project: Project, pi: Pi, record_property: Callable[[str, object], None]) -> None:
    """A `docker` that answers nonsense is that robot's outcome, and the others are done."""
    chance = random.Random(f"{SEED} lies")  # noqa: S311  not for secrets
    hosts = "pi1,pi2"
    project.well("ship", "--hosts", hosts)
    for number in range(1, TIMES + 1):
        word, lie = chance.choice(ASKED), chance.choice(LIES)
        where = f"{word!r}: {lie} (seed {SEED})"
        project.colour(str(number))
        with lying(pi, word=word, lie=lie):
            status = project.fab("status", "--hosts", hosts, "--json", within=90)
            ship = project.fab("ship", "--hosts", hosts, "--json", "--wait", "10", within=240)
        assert set(status.json) == {"pi1", "pi2"}, (where, status)
        assert ship.status["pi2"] == "done", (where, ship)
        assert ship.status["pi1"] in {"done", "failed", "unreachable"}, (where, ship)
        assert not any(sign in ship.out + status.out for sign in ("\u202e", "\x9b")), where
        again = project.fab("ship", "--hosts", hosts, within=180)
        assert again.code == 0, (where, again)
        assert environment(pi)["COLOUR"] == str(number), where
    note(
        record_property,
        fault="a robot whose Docker answers nonsense, without end, or never",
        times=TIMES,
        end="that robot's outcome; the others were done",
    )


POISON = (
    "$(touch {canary})", "`touch {canary}`", "; touch {canary} #", "' touch {canary} '", '"; touch {canary}; "', "| touch {canary}",
    "\n touch {canary}\n", "-rf", "--help", "../../etc", "${{HOME}}", "$HOME", "a b", "", " ", "\t", "é", "\u202e", "\x85", "\U0001f916", "null", "1e3",
    "%s%n", "\\", "'", '"', "~", "*", "{{{{.ID}}}}", "-oProxyCommand=touch {canary}", "@x", "a:b", "[::1]", "0x7f", "1" * 400,
)  # fmt: skip
KEYS = (
    "address",
    "user",
    "port",
    "platform",
    "identity_file",
    "known_hosts",
    "environment",
    "files",
    "ros",
    "docker",
    "stack",
    "robots",
)


def poisoned(chance: random.Random, canary: Path) -> str:
    """An inventory with such words in places where people write names, numbers, paths and values."""

    def word() -> str:
        return chance.choice(POISON).format(canary=canary)

    def value(depth: int = 0) -> object:
        kind = chance.randrange(6 if depth < 3 else 3)
        if kind < 3:
            return word()
        if kind == 3:
            return chance.choice((None, True, -1, 2**70, 1.5, float("nan")))
        if kind == 4:
            return [value(depth + 1) for _ in range(chance.randrange(3))]
        return {chance.choice((word(), *KEYS)): value(depth + 1) for _ in range(chance.randrange(3))}

    robot = {chance.choice(KEYS): value() for _ in range(chance.randrange(4))}
    text: dict[str, object] = {"robots": {chance.choice(("pi1", word())): {"address": "127.0.0.1", **robot}}}
    if chance.random() < 0.5:
        text[chance.choice(("defaults", "groups", "include", "stack", word()))] = value()
    return yaml.safe_dump(text, allow_unicode=True)


def test_hostile_inventories(
    project: Project, pi: Pi, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Each is read or refused in a sentence; and what is read is a value in the container, byte for byte, and never a command."""
    chance = random.Random(f"{SEED} inventories")  # noqa: S311  not for secrets
    canary = tmp_path / "canary"
    path = tmp_path / "hostile.yaml"
    for _ in range(TIMES * 100):
        path.write_text(poisoned(chance, canary), encoding="utf-8")
        with suppress(FleetError):
            inventory.load(path)
    said = project.fab("inventory", "--inventory", str(path))
    assert said.code in {0, 2}, said
    values = {f"V{number}": word.format(canary="/tmp/canary") for number, word in enumerate(POISON)}
    values = {name: value for name, value in values.items() if not {"\n", "\x85"} & set(value)}
    project.stack(tick=service().replace("environment: [", f"environment: [{', '.join(values)}, "))
    project.inventory(everyone={"robots": ["*"], "environment": values})
    project.well("ship", "--hosts", pi.name)
    there = environment(pi)
    assert {name: there.get(name) for name in values} == values
    assert not canary.exists()
    pi.exec("test", "!", "-e", "/tmp/canary")
    note(
        record_property,
        fault="an inventory with commands and nonsense in any place",
        times=TIMES * 100,
        end="read, or refused in a sentence; nothing was executed",
    )
