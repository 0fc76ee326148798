"""A robot that no link reaches, and a stick with FAT32: `fab bundle` here, `sh install` there."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import (
    HEAVY,
    TINY,
    Project,
    current,
    environment,
    eventually,
    prove,
    running,
    service,
)
from tests.support.swap_state import asked, note, state, whole
from tests.support.usb_stick import PLACE, UsbStick

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.lab.conftest import Pi

TIMES = int(os.environ.get("FLEET_FAULTS", "1"))
SEED = int(os.environ.get("FLEET_SEED", "28"))


@pytest.fixture
def stick(tmp_path: Path) -> Iterator[UsbStick]:
    """An empty one, not put in anywhere."""
    if os.geteuid() or not os.access("/dev/fuse", os.W_OK) or not shutil.which("fusefat"):
        pytest.skip("a stick in a file needs root, /dev/fuse and fusefat")
    one = UsbStick(tmp_path)
    yield one
    one.pull_out()


@contextlib.contextmanager
def no_network(pi: Pi) -> Iterator[None]:
    """A robot in a cellar."""
    pi.exec("ip", "link", "set", "eth0", "down")
    try:
        yield
    finally:
        pi.exec("ip", "link", "set", "eth0", "up")


def install(pi: Pi, *arguments: str) -> subprocess.Popen[str]:
    """Start `sh install` on a robot, as a person at its keyboard."""
    who = ("--user", "pi", "--env", "HOME=/home/pi")
    command = ("docker", "exec", *who, pi.container, "sh", f"{PLACE}/install", *arguments)
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    out, _ = process.communicate(timeout=180)
    return process.returncode, out


def written(project: Project, stick: UsbStick, pi: Pi, *flags: str) -> str:
    """Write a bundle for a robot, put the stick into it; what `fab` says."""
    stick.put_in()
    said = project.well("bundle", "--hosts", pi.name, "--out", str(stick.folder), *flags)
    stick.eject()
    stick.put_in(pi)
    return said.out


def test_a_robot_without_a_network_gets_what_ship_would_send(
    project: Project, pi: Pi, stick: UsbStick
) -> None:
    """Installed, unchanged the second time, and unchanged for `fab ship`; the next bundle writes only what is new."""
    project.colour("red")
    written(project, stick, pi, "--sign", str(pi.key))
    with no_network(pi):
        code, said = ended(install(pi))
        assert (code, "signed with a key that may log in here" in said) == (0, True), said
        assert f"{pi.name}: done, release {current(pi)} of tiny runs" in said
        code, said = ended(install(pi))
        assert (code, "unchanged, runs release" in said) == (0, True), said
    stick.eject()
    assert environment(pi)["COLOUR"] == "red"
    prove(pi)
    assert " by stick of " in asked(pi, "cat ~pi/.fleet/stacks/tiny/history")
    assert eventually(lambda: project.fab("ship", "--hosts", pi.name, "--json").status) == {
        pi.name: "unchanged"
    }
    project.colour("green")
    said = written(project, stick, pi)
    assert "3 files written" in said  # the release, the index, READ-ME.txt
    assert "were there already" in said
    code, said = ended(install(pi))
    assert (code, "layers are missing" in said) == (0, False), said
    assert environment(pi)["COLOUR"] == "green"
    assert project.well("rollback", "--hosts", pi.name, "--json").status == {pi.name: "done"}
    code, said = ended(install(pi))
    assert (code, "something newer has come" in said) == (1, True), said
    assert ended(install(pi, "--older"))[0] == 0
    assert environment(pi)["COLOUR"] == "green"
    stick.eject()


def test_ship_takes_what_a_bundle_holds(project: Project, pi: Pi, tmp_path: Path) -> None:
    """Without an image on this computer's side: the reference in the project is one that is nowhere."""
    project.well("bundle", "--hosts", pi.name, "--out", str(tmp_path / "b.tar"))
    project.stack(tick=service("nowhere:1"))
    for status in ("done", "unchanged"):
        shipped = project.well("ship", "--hosts", pi.name, "--from", str(tmp_path / "b.tar"), "--json")
        assert shipped.status == {pi.name: status}
    assert sorted(running(pi)) == ["tick"]
    other = project.fab("ship", "--hosts", project.lab.pis[1].name, "--from", str(tmp_path / "b.tar"))
    assert (other.code, f"it has: {pi.name}" in other.all) == (2, True)


def test_a_stick_that_is_pulled_out_while_a_robot_installs(
    project: Project, pi: Pi, stick: UsbStick, record_property: Callable[[str, object], None]
) -> None:
    """At any moment: one release runs, whole, and the next try goes on to the new one."""
    project.colour("old")
    project.well("ship", "--hosts", pi.name)
    old = current(pi)
    project.stack(tick=service(HEAVY))
    project.colour("new")
    written(project, stick, pi)
    moments = random.Random(SEED)  # noqa: S311  not for secrets
    for number in range(1, TIMES + 1):
        moment = moments.uniform(0.2, 6)
        where = f"pull {number} after {moment:.2f} s (seed {SEED})"
        process = install(pi)
        time.sleep(moment)
        stick.pull_out()
        code, said = ended(process)
        assert eventually(lambda: whole(pi, ["tick"]), within=60), (where, said, state(pi))
        assert (current(pi) == old) == (code != 0), (where, said)
        # 2: the shell itself could not read `install`.
        assert code in (0, 2) or "if the stick was pulled out" in said, (where, said)
        stick.put_in(pi)
        code, said = ended(install(pi))
        assert code == 0, (where, said, state(pi))
        assert (current(pi) != old, whole(pi, ["tick"])) == (True, True), where
        prove(pi)
        project.well("rollback", "--hosts", pi.name, "--to", old)
        forget_heavy(pi)
        project.well("bundle", "--hosts", pi.name, "--out", str(stick.folder))  # newer than the rollback
    stick.eject()
    note(
        record_property,
        fault="stick pulled out during `sh install`",
        times=TIMES,
        end="one release, whole; the next try goes on",
    )


def forget_heavy(pi: Pi) -> None:
    """Let the next install bring it again."""
    pi.exec(
        "sh",
        "-c",
        f"docker ps -aq --filter ancestor={HEAVY} | xargs -r docker rm -f; docker image ls -q {HEAVY} | xargs -r docker image rm -f",
    )
    assert TINY in pi.exec("docker", "image", "ls")


def test_a_stick_that_is_pulled_out_while_a_desktop_writes(project: Project, pi: Pi, stick: UsbStick) -> None:
    """The next run writes the rest, and the bundle is whole."""
    project.stack(tick=service(HEAVY))
    stick.put_in()
    with project.start("bundle", "--hosts", pi.name, "--out", str(stick.folder)) as fab:
        fab.await_text("write layers/")
        time.sleep(0.3)
        stick.pull_out()
        said = fab.end()
    assert (said.code, "put it in again" in said.err) == (1, True), said
    assert "Traceback" not in said.all
    stick.put_in(pi)
    code, told = ended(install(pi))
    assert code != 0, told
    project.well("bundle", "--hosts", pi.name, "--out", str(stick.folder))
    code, told = ended(install(pi))
    assert (code, sorted(running(pi))) == (0, ["tick"]), told
    stick.eject()
