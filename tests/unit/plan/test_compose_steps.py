from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import tarfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.plan import compose_steps
from fleet.plan.step import Bytes, Record, Step
from fleet.robot import paths
from fleet.robot.history import Event, history
from tests.support.samples import PI, release

RECORD = Record(verb="ship", release="3f2a9c1b5d0e", by="tim@desktop")


@pytest.fixture(params=[shell for shell in ("dash", "bash", "busybox") if shutil.which(shell)])
def home(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A robot's home, where ``sh`` is each of the shells that are here."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/sh").symlink_to(shutil.which(request.param) or "")
    (tmp_path / "home").mkdir()
    return tmp_path / "home"


def do(step: Step, home: Path) -> subprocess.CompletedProcess[bytes]:
    """Run a step as a robot would: in its home, with its feed as input, or with an input that stays open."""
    environment = {"PATH": f"{home.parent / 'bin'}:{os.environ['PATH']}", "HOME": str(home)}
    data = step.feed.data if isinstance(step.feed, Bytes) else b""
    with subprocess.Popen(
        step.argv,
        cwd=home,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as command:
        if not step.until_closed:
            out, err = command.communicate(data, timeout=20)
            return subprocess.CompletedProcess(step.argv, command.returncode, out, err)
        code = command.wait(timeout=20)
        assert command.stdin
        command.stdin.close()
        return subprocess.CompletedProcess(step.argv, code, b"", b"")


def tree(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file below a folder: its mode and its bytes."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(p.relative_to(folder)): (p.stat().st_mode & 0o777, p.read_bytes()) for p in files}


def test_a_release_arrives_with_its_bytes_and_modes(home: Path) -> None:
    """``.env`` may hold secrets; what containers mount is readable by them."""
    new = release()
    done = do(compose_steps.write(new), home)
    assert (done.returncode, done.stderr) == (0, b"")
    assert tree(home / paths.folder(new.id)) == {
        name: (0o600 if name == ".env" else 0o644, data) for name, data in new.files.items()
    }
    assert (home / paths.folder(new.id) / "files").is_dir()


def test_writing_a_release_again_leaves_its_files_in_place(home: Path) -> None:
    """Running containers have them mounted: a file replaced by an equal one would be a deleted one to them."""
    new = release()
    do(compose_steps.write(new), home)
    before = {path: path.stat().st_ino for path in home.rglob("*")}
    assert do(compose_steps.write(new), home).returncode == 0
    assert {path: path.stat().st_ino for path in home.rglob("*")} == before


def test_a_damaged_release_is_made_whole_again(home: Path) -> None:
    """Whatever was cut, edited or added by hand, the directory is what the release says."""
    new = release()
    folder = home / paths.folder(new.id)
    do(compose_steps.write(new), home)
    (folder / ".env").write_bytes(b"")
    (folder / "extra").write_text("by hand")
    part = folder.with_name(folder.name + paths.PART)
    part.mkdir()
    (part / "half").write_bytes(b"written before the power went")
    os.utime(part, (0, 0))  # long ago: what is new may be somebody else's, who ships at this moment
    assert do(compose_steps.write(new), home).returncode == 0
    assert {name: data for name, (_, data) in tree(folder).items()} == dict(new.files)
    assert [path.name for path in folder.parent.iterdir()] == [new.id]


def test_an_archive_that_was_cut_replaces_nothing(home: Path) -> None:
    """The link died in the middle of the bytes: the release that was there stays, and the step fails."""
    new = release()
    step = compose_steps.write(new)
    do(step, home)
    before = tree(home / paths.folder(new.id))
    assert isinstance(step.feed, Bytes)
    cut = Step(title="", argv=step.argv, feed=Bytes(label="", data=step.feed.data[:1300]))
    assert do(cut, home).returncode != 0
    assert tree(home / paths.folder(new.id)) == before


def test_a_file_name_with_spaces_and_quotes_arrives(home: Path, tmp_path: Path) -> None:
    """Names come from the inventory and go through tar, never through a shell."""
    (tmp_path / "here").write_text("42")
    odd = "odd/it's $HOME `x`.yaml"
    new = release(robot=PI.model_copy(update={"files": {odd: tmp_path / "here"}}))
    assert do(compose_steps.write(new), home).returncode == 0
    assert (home / paths.folder(new.id) / "files" / odd).read_text() == "42"


def switch(release: str, *command: str) -> Step:
    """Start a release, with another command in place of Compose."""
    step = compose_steps.start(PI, release, wait=1)
    return replace(step, argv=(*step.argv[: step.argv.index(release) + 1], *(command or ("true",))))


def test_a_release_that_does_not_start_is_not_made_current(home: Path) -> None:
    """The exit code of Compose is that of the step, and ``current`` stays."""
    (home / paths.folder("one")).mkdir(parents=True)
    assert do(switch("one"), home).returncode == 0
    assert do(switch("two", "sh", "-c", "exit 17"), home).returncode == 17
    assert (home / ".fleet/current").readlink() == Path("releases/one")


def test_two_people_start_one_after_the_other(home: Path) -> None:
    """What one starts has ended before the other's begins."""
    (home / ".fleet").mkdir()
    command = 'echo in >> told; while [ ! -e "$1" ]; do :; done; echo out >> told'
    argvs = [switch(name, "sh", "-c", command, "sh", "go").argv for name in ("one", "two")]
    both = [subprocess.Popen(argv, cwd=home, stdin=subprocess.PIPE) for argv in argvs]
    told = home / "told"
    end = time.monotonic() + 20
    while not told.exists():
        assert time.monotonic() < end
    soon = time.monotonic() + 0.5
    while time.monotonic() < soon:
        assert told.read_text().split() in ([], ["in"])
    (home / "go").touch()
    assert [one.wait(timeout=20) for one in both] == [0, 0]
    for one in both:
        assert one.stdin
        one.stdin.close()
    assert told.read_text().split() == ["in", "out", "in", "out"]


def test_a_start_ends_with_the_connection(home: Path) -> None:
    """Ctrl-C at the desktop closes the input: what was starting is ended, and the next person's turn comes at once."""
    (home / ".fleet").mkdir()
    with subprocess.Popen(switch("one", "sleep", "60").argv, cwd=home, stdin=subprocess.PIPE) as command:
        assert command.stdin
        command.stdin.close()
        assert command.wait(timeout=20) != 0
    assert not (home / ".fleet/current").exists()
    assert do(switch("two"), home).returncode == 0


def test_current_is_there_at_every_moment_of_a_switch(home: Path) -> None:
    """Whoever reads the link while it changes finds the old or the new release, never none."""
    for name in ("one", "two"):
        (home / paths.folder(name)).mkdir(parents=True)
    assert do(switch("one"), home).returncode == 0
    seen: set[str] = set()
    over = threading.Event()

    def read() -> None:
        while not over.is_set():
            try:
                seen.add(str((home / ".fleet/current").readlink()))
            except OSError as problem:
                seen.add(str(problem))

    reader = threading.Thread(target=read)
    reader.start()
    for name in ("two", "one") * 10:
        assert do(switch(name), home).returncode == 0
    over.set()
    reader.join()
    assert seen <= {"releases/one", "releases/two"}
    assert (home / ".fleet/current").resolve() == (home / paths.folder("one")).resolve()
    assert sorted(path.name for path in (home / ".fleet").iterdir()) == ["current", "lock", "releases"]


def test_a_switch_replaces_a_link_to_what_is_gone(home: Path) -> None:
    """A release that somebody removed by hand must not keep the next one from becoming current."""
    (home / ".fleet").mkdir()
    (home / ".fleet/current").symlink_to("releases/removed")
    assert do(switch("two"), home).returncode == 0
    assert (home / ".fleet/current").readlink() == Path("releases/two")


def test_an_event_is_one_line_whatever_it_says(home: Path) -> None:
    """Reasons have newlines, tabs and quotes in them, and the history is read by lines and tabs."""
    events = ('failed: "a"\n\tb $(touch /tmp/x) %s \\n', "done")
    for what in events:
        assert (
            do(compose_steps.note(RECORD, when="2026-11-23T12:00:00Z", what_came=what), home).returncode == 0
        )
    text = (home / ".fleet/history").read_text()
    first = "2026-11-23T12:00:00Z\tship\t3f2a9c1b5d0e\ttim@desktop\t"
    assert text == f'{first}failed: "a" b $(touch /tmp/x) %s \\n\n{first}done\n'
    assert [event.outcome for event in history(tuple(text.splitlines()))] == [
        'failed: "a" b $(touch /tmp/x) %s \\n',
        "done",
    ]


@given(st.lists(st.text(), min_size=5, max_size=5))
def test_any_event_comes_back(words: list[str]) -> None:
    """White space apart, what was noted is what is read, from one line of the file."""
    when, verb, of, by, outcome = (" ".join(word.split()) for word in words)
    event = Event(when=words[0], verb=words[1], release=words[2], by=words[3], outcome=words[4])
    assert history(tuple(str(event).splitlines())) in (
        (Event(when=when, verb=verb, release=of, by=by, outcome=outcome),),
        (),  # nothing but white space
    )


@given(st.lists(st.text()))
def test_lines_that_are_no_events_are_passed_over(garbage: list[str]) -> None:
    """A history that a full disk cut, or a person edited, is still read."""
    good = "2026-11-23T12:00:00Z\tship\tabc\ttim@desktop\tdone"
    read = history((*(line for line in garbage if line.count("\t") != 4), good))
    assert read == (
        Event(when="2026-11-23T12:00:00Z", verb="ship", release="abc", by="tim@desktop", outcome="done"),
    )


def test_compose_runs_in_the_release_and_heeds_its_env_file_only() -> None:
    """A login's own ROS_MASTER_URI would win over ``.env``, so the variables of the release are unset first."""
    robot = PI.model_copy(update={"environment": {"TALKER_RATE": "2"}})
    argv = compose_steps.compose(robot, "abc", "ps")
    assert argv[:3] == ("env", "-C", ".fleet/releases/abc")
    assert argv[-3:] == ("docker", "compose", "ps")
    unset = argv[3:-3]
    assert unset[::2] == ("-u",) * (len(unset) // 2)
    assert {"TALKER_RATE", "ROS_MASTER_URI", "ROS_HOSTNAME", "ROS_IP", "COMPOSE_PROJECT_NAME"} <= set(
        unset[1::2]
    )


def test_env_as_it_is_called_reads_the_release_and_not_the_login(home: Path) -> None:
    """The argv works with the ``env`` of Debian: it changes the folder and drops the login's variables."""
    folder = home / paths.folder("abc")
    folder.mkdir(parents=True)
    argv = compose_steps.compose(PI, "abc")[: -len(("docker", "compose"))]
    script = "pwd; echo ${ROS_MASTER_URI-unset} ${OTHER-unset}"
    environment = {"PATH": os.environ["PATH"], "ROS_MASTER_URI": "http://elsewhere:11311", "OTHER": "kept"}
    done = subprocess.run(
        (*argv, "sh", "-c", script), cwd=home, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{folder}\nunset kept\n"


def test_starting_never_pulls_or_builds_and_is_given_time() -> None:
    """A robot has no registry; Compose waits for health, and the step outlives Compose's own wait."""
    step = compose_steps.start(PI, "abc", wait=120)
    assert step.title == "start release abc"
    assert step.argv[step.argv.index("compose") :] == (
        "compose",
        "up",
        "--detach",
        "--wait",
        "--wait-timeout",
        "120",
        "--no-build",
        "--pull",
        "never",
        "--remove-orphans",
    )
    assert step.limit is not None
    assert step.limit > 120.0


def test_stopping_and_last_words() -> None:
    """Containers are stopped, not removed, and their last lines are asked for without colours."""
    assert compose_steps.stop(PI, "abc").argv[-2:] == ("compose", "stop")
    words = ("compose", "logs", "--no-color", "--no-log-prefix", "--tail", "8")
    assert compose_steps.last_words(PI, "abc").argv[-len(words) :] == words


def test_the_archive_is_one_that_any_tar_reads() -> None:
    """Names only below the release's directory: nothing absolute, nothing that climbs."""
    with tarfile.open(fileobj=io.BytesIO(release().archive())) as archive:
        names = archive.getnames()
    assert sorted(names) == [".env", "compose.override.yaml", "compose.yaml", "files"]


@pytest.mark.parametrize(("beats", "lives"), [(True, True), (False, False)])
def test_what_nobody_listens_to_any_more_ends(beats: bool, lives: bool) -> None:
    """A lost link closes nothing: the command goes on for as long as signs of life come, and no longer."""
    _, dash_c, script, *rest = compose_steps.until_closed(("sleep", "30"))
    argv = ("sh", dash_c, script.replace("timeout 45", "timeout 1"), *rest)
    with subprocess.Popen(argv, stdin=subprocess.PIPE, start_new_session=True) as process:
        assert process.stdin
        for _ in range(12):
            time.sleep(0.25)
            if beats:
                process.stdin.write(b".")
                process.stdin.flush()
        assert (process.poll() is None) == lives
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 9)
