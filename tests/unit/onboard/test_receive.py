from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import threading
import time
import uuid
from dataclasses import dataclass, replace
from typing import IO, TYPE_CHECKING

import pytest

from fleet.plan.step import Upload, UploadBatch
from fleet.transfer import load_archive, receive
from fleet.transfer.receive import TransferRun
from tests.support.handmade import Engine, Handmade, digest, layer, packed
from tests.support.robot_shell import EACH_SHELL

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from fleet.images.layer import Blob
    from fleet.transfer.load_archive import ArchiveSkeleton

ONE, OTHER = "one", "other"
"""Runs, by their tokens."""


@dataclass(frozen=True, kw_only=True)
class Load:
    """Some images to be sent, and the bytes of their uploads by digest (hex), in the order in which the robot asks."""

    skeleton: ArchiveSkeleton
    layers: tuple[Blob, ...]
    contents: Mapping[str, bytes]

    @property
    def size(self) -> int:
        return sum(map(len, self.contents.values()))

    def argv(self, *, token: str, by: str) -> tuple[str, ...]:
        uploads = tuple(Upload(digest=name, size=len(content)) for name, content in self.contents.items())
        batch = UploadBatch(label="layers", to="pi1", pieces=uploads)
        run = TransferRun(to="pi1", token=token, by=by)
        return receive.step(batch, self.skeleton, self.layers, {}, title="send layers", run=run).argv


def load(*images: Handmade, without: tuple[bytes, ...] = ()) -> Load:
    """All that these images need, except layers that the robot has."""
    blobs: dict[str, Blob] = {}
    contents: dict[str, bytes] = {}
    for data in (data for image in images for data in image.layers if data not in without):
        blob, content = packed(data)
        blobs[blob.diff_id], contents[blob.hex] = blob, content
    targets = [image.wanted for image in images]
    skeleton = load_archive.skeleton(targets, blobs=blobs, sent=list(blobs.values()))
    return Load(
        skeleton=skeleton,
        layers=tuple(blobs.values()),
        contents={skeleton.hex: skeleton.data, **contents},
    )


@dataclass(frozen=True, kw_only=True)
class Running:
    """The script while it runs, and the bytes that it may ask for."""

    process: subprocess.Popen[bytes]
    contents: Mapping[str, bytes]

    def feed(self, most: int = 10**9) -> tuple[int, list[str]]:
        """Send what the script asks for, at most ``most`` bytes; return their number and the lines it printed."""
        lines: list[str] = []
        sent = 0
        while sent < most and (line := _pipe(self.process.stdout).readline()):
            lines.append(line.decode().rstrip("\n"))
            word, *rest = lines[-1].split()
            if word == "need":
                data = self.contents[rest[0]][int(rest[1]) :][: most - sent]
                sent += len(data)
                with contextlib.suppress(BrokenPipeError):
                    _pipe(self.process.stdin).write(data)
                    _pipe(self.process.stdin).flush()
        return sent, lines

    def end(self) -> tuple[int, str]:
        """Close its input, as a lost connection does; return its exit code and its standard error."""
        with contextlib.suppress(BrokenPipeError):
            _pipe(self.process.stdin).close()
        code = self.process.wait(60)
        return code, _pipe(self.process.stderr).read().decode().strip()


def _end(group: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def _pipe(end: IO[bytes] | None) -> IO[bytes]:
    assert end is not None
    return end


class Pi:
    """A robot: a home in a folder, and the Docker of this computer with private names that only this test uses.

    Its `sleep` is ten times as fast, or faster, for the script's pauses.
    """

    def __init__(self, folder: Path, engine: Engine) -> None:
        self.home = folder / "home of pi"
        self.spool = self.home / ".fleet/spool"
        self.engine = engine
        self._programs = folder / "bin"
        for path in (self.home, self._programs):
            path.mkdir()
        self._program("sleep", f'case $1 in 1 | 2) set -- 0.1 ;; esac; exec {shutil.which("sleep")} "$1"')
        self._running: list[subprocess.Popen[bytes]] = []
        self._ends: list[threading.Timer] = []

    def begin(
        self,
        what: Load,
        *,
        token: str = ONE,
        by: str = "tim@desktop",
        shell: str = "sh",
        whole: bool = True,
    ) -> Running:
        """Run the script as SSH would, in a session of its own; one that is not ``whole`` ends when all has arrived."""
        _, dash_c, script, *arguments = what.argv(token=token, by=by)
        script = script if whole else script[: script.index("\necho enough")] + "\necho enough"
        argv = (shell, "sh") if shell == "busybox" else (shell,)
        process = subprocess.Popen(
            (*argv, dash_c, script, *arguments),
            cwd=self.home,
            env={**os.environ, "HOME": str(self.home), "PATH": f"{self._programs}:{os.environ['PATH']}"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        self._running.append(process)
        self._ends.append(threading.Timer(60, _end, (process.pid,)))  # a test that hangs fails then
        self._ends[-1].start()
        return Running(process=process, contents=what.contents)

    def ship(self, what: Load, *, most: int = 10**9, whole: bool = True) -> tuple[int, str, int, list[str]]:
        """Run the script to its end: exit code, standard error, bytes that were sent, lines that it printed."""
        running = self.begin(what, whole=whole)
        sent, lines = running.feed(most)
        return (*running.end(), sent, lines)

    def docker(self, verb: str, script: str) -> None:
        """Do something else for one verb of ``docker``; ``docker`` in the script is the real one."""
        real = shutil.which("docker")
        self._program(
            "docker",
            f'docker() {{ {real} "$@"; }}\nif [ "$1" = {verb} ]; then {script}\nelse docker "$@"; fi',
        )

    def _program(self, name: str, script: str) -> None:
        path = self._programs / name
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)

    def spooled(self) -> dict[str, int]:
        """The sizes of the uploads in its spool, as far as they have arrived."""
        return {path.name: path.stat().st_size for path in self.spool.iterdir() if len(path.name) == 64}

    def grow_old(self) -> None:
        """Two minutes pass in which nothing arrives."""
        for path in self.spool.iterdir():
            os.utime(path, (time.time() - 120,) * 2)

    def clear(self) -> None:
        for timer in self._ends:
            timer.cancel()
        for process in self._running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, 9)
            process.wait()
            for pipe in (process.stdin, process.stdout, process.stderr):
                with contextlib.suppress(BrokenPipeError):
                    _pipe(pipe).close()
        self.engine.clear()


@pytest.fixture
def pi(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, desktop: None) -> Iterator[Pi]:  # noqa: ARG001
    robot = Pi(tmp_path, Engine())
    monkeypatch.setattr(load_archive, "INCOMING", robot.engine.incoming)
    yield robot
    robot.clear()


def image(pi: Pi, *layers: bytes, name: str = "", run: Mapping[str, object] | None = None) -> Handmade:
    """An image of these layers, or of one that no engine has seen, under a name of the test's own."""
    return Handmade(
        layers=layers or (fresh(),), reference=f"{pi.engine.name}{name}:latest-amd64", run=run or {}
    )


def fresh() -> bytes:
    """A layer that no engine has seen."""
    return layer(uuid.uuid4().int)


def needs(lines: list[str]) -> list[tuple[str, int]]:
    """Which uploads were asked for, from which byte on."""
    return [(words[1], int(words[2])) for words in map(str.split, lines) if words[0] == "need"]


def test_a_transfer_from_the_first_byte_to_the_name(pi: Pi) -> None:
    """Each upload is asked for once, the image has its name and its ID, and nothing is left but the manifest."""
    talker = image(pi, fresh(), fresh())
    sent = load(talker)
    code, complaint, count, lines = pi.ship(sent)
    assert (code, complaint, count) == (0, "", sent.size)
    assert lines == [*(f"need {name} 0" for name in sent.contents), "enough"]
    (manifest,) = sent.skeleton.manifests
    assert pi.engine.says("image", "inspect", "--format", "{{.Id}}", talker.image.shipped_as) in manifest.ids
    assert pi.engine.tags(pi.engine.incoming) == []
    assert [path.name for path in pi.spool.iterdir()] == ["lock"]
    (kept,) = (pi.home / ".fleet/receipts").iterdir()
    assert kept.name == talker.image.fingerprint
    assert digest(kept.read_bytes()) == manifest.ids[1]


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_uploads_are_collected_by_the_shells_of_robots(pi: Pi, shell: str) -> None:
    """Interrupted once, and resumed by the same run."""
    sent = load(image(pi, fresh(), fresh()))
    first = pi.begin(sent, shell=shell, whole=False)
    assert first.feed(sent.size // 2)[0] == sent.size // 2
    assert first.end() == (74, "")
    second = pi.begin(sent, shell=shell, whole=False)
    count, lines = second.feed()
    assert (count, lines[-1], second.end()) == (sent.size - sent.size // 2, "enough", (0, ""))
    assert pi.spooled() == {name: len(content) for name, content in sent.contents.items()}


@pytest.mark.parametrize("seed", range(3))
def test_cut_anywhere_and_resumed(pi: Pi, seed: int) -> None:
    """Also within the skeleton, and by another desktop each time: no byte is sent twice, and the image is whole."""
    chance = random.Random(seed)  # noqa: S311  no secret
    talker = image(pi, fresh(), fresh())
    sent = load(talker)
    cuts = sorted({chance.randrange(1, len(sent.skeleton.data)), *chance.sample(range(1, sent.size), 5)})
    arrived = 0
    for cut in cuts:
        running = pi.begin(sent, token=f"of {cut}", by=f"tim@{cut}")
        count, _ = running.feed(cut - arrived)
        assert (count, running.end()) == (cut - arrived, (74, ""))
        arrived += count
        assert sum(pi.spooled().values()) == arrived
    code, complaint, count, _ = pi.ship(sent)
    assert (code, complaint, arrived + count) == (0, "", sent.size)
    assert pi.engine.tags() == [talker.image.shipped_as.rpartition(":")[2]]


@pytest.mark.parametrize(
    ("spoil", "asked"),
    [
        (lambda content: content, [-1]),
        (lambda content: content[:5000], [5000]),
        (lambda content: content[:-1] + b"x", [-1, 0]),
        (lambda content: b"x" + content[1:5000], [5000, 0]),
        (lambda content: content + b"x", [0]),
        (lambda _: b"", [0]),
    ],
    ids=["whole", "cut", "damaged", "cut and damaged", "too long", "empty"],
)
def test_what_lies_in_the_spool_is_used_if_it_is_right(pi: Pi, spoil: object, asked: list[int]) -> None:
    """Bytes that were flipped, or are too many, are asked for again from the first; -1 stands for the end."""
    assert callable(spoil)
    sent = load(image(pi))
    name, content = list(sent.contents.items())[-1]
    pi.spool.mkdir(parents=True)
    (pi.spool / name).write_bytes(spoil(content))
    code, complaint, _, lines = pi.ship(sent, whole=False)
    assert (code, complaint, lines[-1]) == (0, "", "enough")
    assert needs(lines)[1:] == [(name, len(content) if at < 0 else at) for at in asked]
    assert (pi.spool / name).read_bytes() == content


@pytest.mark.parametrize(
    "obstruct",
    [
        lambda path: path.mkdir(),
        lambda path: (path / "sub").mkdir(parents=True),
        os.mkfifo,
        lambda path: path.symlink_to("/dev/zero"),
        lambda path: path.symlink_to("nowhere"),
    ],
    ids=["folder", "full folder", "pipe", "link to a device", "link to nothing"],
)
def test_what_is_no_file_makes_place_for_an_upload(pi: Pi, obstruct: object) -> None:
    """It would fail for ever, or be waited for."""
    assert callable(obstruct)
    sent = load(image(pi))
    name, content = list(sent.contents.items())[-1]
    pi.spool.mkdir(parents=True)
    obstruct(pi.spool / name)
    code, complaint, _, lines = pi.ship(sent, whole=False)
    assert (code, complaint, lines[-1]) == (0, "", "enough")
    assert (pi.spool / name).read_bytes() == content
    assert not (pi.spool / name).is_symlink()


@pytest.mark.parametrize("number", [0, 1])
def test_bytes_that_are_wrong_when_they_come_are_not_used(pi: Pi, number: int) -> None:
    """Skeleton or layer: it ends, nothing has got a name, and the upload is not kept."""
    talker = image(pi)
    sent = load(talker)
    name = list(sent.contents)[number]
    wrong = {**sent.contents, name: bytes(len(sent.contents[name]))}
    code, complaint, _, lines = pi.ship(replace(sent, contents=wrong))
    assert (code, complaint) == (65, f"upload {name} arrived damaged")
    assert "enough" not in lines
    assert pi.engine.tags() == pi.engine.tags(pi.engine.incoming) == []
    assert name not in pi.spooled()


def test_a_desktop_that_goes_away_leaves_what_it_sent(pi: Pi) -> None:
    """After Ctrl-C its input is closed: all bytes are kept, and the next transfer need not wait."""
    sent = load(image(pi))
    running = pi.begin(sent)
    running.feed(len(sent.skeleton.data) + 1234)
    assert running.end() == (74, "")
    assert pi.spooled() == {sent.skeleton.hex: len(sent.skeleton.data), list(sent.contents)[1]: 1234}
    lines = pi.ship(sent, whole=False)[3]
    assert lines[-1] == "enough"
    assert not any(line.startswith("wait") for line in lines)


def test_a_second_transfer_waits_and_then_names_the_first(pi: Pi, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first is not disturbed."""
    shorten(monkeypatch, 5)
    sent = load(image(pi, fresh(), fresh()))
    first = pi.begin(sent, by="ann of lab@desk 1", whole=False)
    count, _ = first.feed(30_000)
    second = pi.begin(sent, token=OTHER, by="tim@desktop")
    assert second.feed() == (0, ["wait for ann_of_lab@desk_1"])
    assert second.end() == (75, "ann_of_lab@desk_1 is shipping to this robot")
    name, at = list(sent.contents)[1], 30_000 - len(sent.skeleton.data)
    _pipe(first.process.stdin).write(sent.contents[name][at:])
    _pipe(first.process.stdin).flush()
    assert first.feed()[0] + len(sent.contents[name]) - at + count == sent.size
    assert first.end() == (0, "")


def shorten(monkeypatch: pytest.MonkeyPatch, turns: int) -> None:
    """Wait for so many turns only."""
    monkeypatch.setattr(receive, "STALE", turns)


def test_a_second_transfer_goes_on_when_the_first_has_ended(pi: Pi) -> None:
    """It has waited for its turn, and then finds what the first has left."""
    sent = load(image(pi))
    first = pi.begin(sent, by="ann@desk")
    first.feed(len(sent.skeleton.data))
    second = pi.begin(sent, token=OTHER, whole=False)
    assert _pipe(second.process.stdout).readline() == b"wait for ann@desk\n"
    first.end()
    count, lines = second.feed()
    assert (count, lines[-1]) == (sent.size - len(sent.skeleton.data), "enough")
    assert second.end() == (0, "")


@pytest.mark.parametrize(
    ("token", "old", "taken"),
    [("one", False, True), ("one", True, True), ("other", True, True), ("other", False, False)],
)
def test_whose_place_is_taken(
    pi: Pi, monkeypatch: pytest.MonkeyPatch, token: str, old: bool, taken: bool
) -> None:
    """That of an earlier connection of the same run at once; that of another run after a minute without bytes."""
    shorten(monkeypatch, 5)
    sent = load(image(pi, layer(uuid.uuid4().int, size=200_000)))
    first = pi.begin(sent)
    first.feed(100_000)
    wait_for(lambda: sum(pi.spooled().values()) > 95_000)  # `head` may hold back one buffer
    if old:
        pi.grow_old()
    second = pi.begin(sent, token=token, whole=False)
    count, lines = second.feed()
    code, _ = second.end()
    assert (code, first.process.poll() is not None) == ((0, True) if taken else (75, False))
    if taken:
        assert lines[-1] == "enough"
        assert sent.size - 100_000 <= count < sent.size - 95_000


def wait_for(truth: object) -> None:
    assert callable(truth)
    end = time.monotonic() + 20
    while not truth() and time.monotonic() < end:
        time.sleep(0.01)
    assert truth()


def test_one_that_lost_its_link_while_it_waited_ends_nobody(pi: Pi, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is of the same run as the one that came after it, which has the turn."""
    shorten(monkeypatch, 20)
    pi.spool.mkdir(parents=True)
    holding = ("flock", pi.spool / "lock", "sh", "-c", "echo held; exec sleep 60")
    somebody = subprocess.Popen(holding, stdout=subprocess.PIPE, start_new_session=True)
    assert _pipe(somebody.stdout).readline() == b"held\n"
    sent = load(image(pi, fresh(), fresh()))
    older = pi.begin(sent, whole=False)
    assert _pipe(older.process.stdout).readline() == b"wait for somebody\n"
    older.process.send_signal(signal.SIGSTOP)
    younger = pi.begin(sent, whole=False)
    os.killpg(somebody.pid, signal.SIGKILL)
    somebody.communicate()
    count, _ = younger.feed(30_000)
    older.process.send_signal(signal.SIGCONT)
    assert older.end()[0] == 75
    rest = list(sent.contents.values())[1][count - len(sent.skeleton.data) :]
    _pipe(younger.process.stdin).write(rest)
    _pipe(younger.process.stdin).flush()
    assert younger.feed()[1][-1] == "enough"
    assert younger.end() == (0, "")


@pytest.mark.parametrize(("token", "code"), [("other", 75), ("one", 0)])
def test_a_transfer_that_is_being_loaded_is_not_dead(
    pi: Pi, monkeypatch: pytest.MonkeyPatch, token: str, code: int
) -> None:
    """Nothing arrives then, for minutes on a slow card; only its own run, back after a cut, takes its place."""
    shorten(monkeypatch, 5)
    sent = load(image(pi))
    pi.docker("load", "sleep 60")
    first = pi.begin(sent)
    assert first.feed(sent.size)[0] == sent.size
    assert _pipe(first.process.stdout).readline() == b"enough\n"
    wait_for(lambda: " load " in (pi.spool / "holder").read_text())
    pi.grow_old()
    second = pi.begin(sent, token=token, whole=False)
    count, _ = second.feed()
    assert (count, second.end()[0]) == (0, code)


def test_layers_that_are_there_need_not_be_sent(pi: Pi) -> None:
    """The engine takes them from an image that has the same ones below."""
    base, code = fresh(), fresh()
    pi.engine.load(image(pi, base, name="").saved())
    talker = image(pi, base, code)
    code_only = load(talker, without=(base,))
    assert code_only.size < 50_000
    assert pi.ship(code_only)[:2] == (0, "")
    layers = pi.engine.says("image", "inspect", "--format", "{{.RootFS.Layers}}", talker.image.shipped_as)
    assert layers == f"[{' '.join(talker.diff_ids)}]"


def test_layers_that_were_left_out_and_are_not_there_are_noticed(pi: Pi) -> None:
    """The robot was pruned after its layers were listed: no image gets the name, and another strategy may help."""
    base = fresh()
    code, complaint, _, lines = pi.ship(load(image(pi, base, fresh()), without=(base,)))
    assert (code, lines[-1]) == (65, "enough")
    assert "no such file or directory" in complaint
    assert pi.engine.tags() == pi.engine.tags(pi.engine.incoming) == []


def test_two_images_in_one_transfer(pi: Pi) -> None:
    """Layers that both have come once."""
    base = fresh()
    talker, camera = image(pi, base, fresh()), image(pi, base, fresh())
    sent = load(talker, camera)
    assert len(sent.contents) == 4
    assert pi.ship(sent)[:3] == (0, "", sent.size)
    assert pi.engine.tags() == sorted(f"fleet-{one.image.fingerprint}" for one in (talker, camera))
    assert len(list((pi.home / ".fleet/receipts").iterdir())) == 2


def test_one_image_under_two_names(pi: Pi) -> None:
    """Two services that are built from the same files: both names are given."""
    data = fresh()
    talker, camera = image(pi, data, name="/talker"), image(pi, data, name="/camera")
    assert talker.image.fingerprint == camera.image.fingerprint
    try:
        assert pi.ship(load(talker, camera))[:2] == (0, "")
        for one in (talker, camera):
            assert pi.engine.says("image", "inspect", "--format", "{{.Os}}", one.image.shipped_as) == "linux"
        assert pi.engine.tags(pi.engine.incoming) == []
    finally:
        pi.engine.says("image", "rm", "--force", talker.image.shipped_as, camera.image.shipped_as)


def test_a_robot_that_lost_power_in_the_middle_of_the_proof(pi: Pi) -> None:
    """The container that proves an image holds its private name: both are cleared away by the next attempt."""
    sent = load(image(pi))
    pi.docker("rm", 'kill -9 "$PPID"')
    assert pi.ship(sent)[0] == -9
    left = pi.engine.says("ps", "-aq", "--filter", f"label={pi.engine.incoming}")
    assert left
    pi.docker("nothing", "true")
    assert pi.ship(sent)[:3] == (0, "", 0)
    assert pi.engine.says("ps", "-aq", "--filter", f"label={pi.engine.incoming}") == ""
    assert pi.engine.tags(pi.engine.incoming) == []


def test_the_proof_of_an_image_with_a_volume_leaves_none(pi: Pi) -> None:
    """Docker makes the volume with the container, and keeps it without `--volumes`."""
    mounts = "{{range .Mounts}}{{.Name}}{{end}}"
    note = f"id=$(docker \"$@\") && docker inspect --format '{mounts}' $id > '{pi.home}/volume'; echo $id"
    pi.docker("create", note)
    assert pi.ship(load(image(pi, run={"Volumes": {"/data": {}}})))[:2] == (0, "")
    volume = (pi.home / "volume").read_text().strip()
    assert len(volume) == 64
    assert pi.engine.says("volume", "ls", "-q", "--filter", f"name={volume}") == ""


def test_an_image_that_arrives_as_another_gets_no_name(pi: Pi) -> None:
    """Whatever the engine says, its ID was known before."""
    sent = load(image(pi))
    (manifest,) = sent.skeleton.manifests
    other = (f"sha256:{'0' * 64}", f"sha256:{'1' * 64}")
    expecting = replace(sent, skeleton=replace(sent.skeleton, manifests=(replace(manifest, ids=other),)))
    code, complaint, _, _ = pi.ship(expecting)
    assert (code, complaint) == (65, f"{manifest.image.name} arrived as {manifest.ids[0]}")
    assert pi.engine.tags() == []


@pytest.mark.parametrize(
    ("script", "code", "complaint", "loads"),
    [
        ("echo 'Loaded image: x'; echo 'Error unpacking image x: not found'", 65, "Error unpacking", 2),
        ("echo 'write /x: no space left on device' >&2; exit 1", 1, "no space left on device", 1),
        ("echo 'unexpected EOF' >&2; exit 1", 65, "unexpected EOF", 2),
    ],
)
def test_an_engine_that_fails(pi: Pi, script: str, code: int, complaint: str, loads: int) -> None:
    """A containerd store says success of a broken image; another strategy helps against all but a full disk."""
    pi.docker("load", f"echo >> '{pi.home}/loads'; cat > /dev/null; {script}")
    exit_code, error, _, _ = pi.ship(load(image(pi)))
    assert exit_code == code
    assert complaint in error
    assert (pi.home / "loads").read_text().count("\n") == loads
    assert pi.engine.tags() == []


def test_an_engine_that_restarts_is_given_it_once_more(pi: Pi) -> None:
    """All bytes are there; it only has to be back."""
    talker = image(pi)
    again = f"'{pi.home}/again'"
    pi.docker("load", f'if [ -e {again} ]; then docker "$@"; else touch {again}; echo gone >&2; exit 1; fi')
    assert pi.ship(load(talker))[:2] == (0, "")
    assert pi.engine.tags() == [f"fleet-{talker.image.fingerprint}"]


def test_what_is_there_is_not_asked_for_again(pi: Pi) -> None:
    """The connection dropped after the load, before the robot could report it; or another desktop has shipped the same."""
    sent = load(image(pi))
    assert pi.ship(sent)[0] == 0
    code, _, count, lines = pi.ship(sent)
    assert (code, count, needs(lines), pi.spooled()) == (0, 0, [], {})
