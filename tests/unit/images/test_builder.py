from __future__ import annotations

import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.images import build, builder
from fleet.images.build import Command
from fleet.images.emulation import desktop_platform
from fleet.images.image import tagged_for
from tests.support.small_image import make_image
from tests.support.sshd import free_port

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

GOOD = 'echo "#1 [1/2] FROM x"; echo "#1 CACHED"; echo "#2 [2/2] RUN make"; echo "#2 0.1 made" >&2; echo "#2 DONE 1s"'


def run(folder: Path, *argv: str, feed: str = "") -> tuple[builder.Built, list[str]]:
    steps: list[str] = []
    command = Command(
        title="build r/a:latest-arm64 for linux/arm64",
        argv=argv,
        reference="r/a:latest-arm64",
        platform="linux/arm64",
        feed=feed,
    )
    return builder.run(command, on_step=steps.append, folder=folder), steps


def test_a_build_is_quiet_and_its_output_is_kept(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Only steps that work are told; all that it printed is in the log."""
    built, steps = run(tmp_path / "logs", "sh", "-c", GOOD)
    assert steps == ["build for linux/arm64", "[2/2] RUN make"]
    assert (built.summary, str(built)) == ("2 steps, 1 cached", f"2 steps, 1 cached, {built.seconds:.1f} s")
    assert built.log == tmp_path / "logs/r_a_latest-arm64.log"
    assert built.log.read_text().splitlines()[-2:] == ["#2 0.1 made", "#2 DONE 1s"]
    assert capfd.readouterr() == ("", "")


def test_a_build_that_fails_says_where_and_what(tmp_path: Path) -> None:
    """The step, its last lines, and the place of the rest."""
    with pytest.raises(DesktopError) as caught:
        run(tmp_path, "sh", "-c", GOOD + '; echo "#3 [3/3] RUN x"; echo "#3 ERROR: boom"; exit 7')
    assert caught.value.what == "build r/a:latest-arm64 for linux/arm64 failed in [3/3] RUN x\n  | boom"
    assert caught.value.cure == f"the whole output is in {tmp_path}/r_a_latest-arm64.log"
    with pytest.raises(DesktopError, match=r"failed with code 7\n  \| no steps"):
        run(tmp_path, "sh", "-c", "echo no steps; exit 7")


def test_a_dockerfile_in_the_compose_file_is_fed(tmp_path: Path) -> None:
    """However long it is; a build without one reads nothing."""
    built, _ = run(tmp_path, "sh", "-c", "wc -c", feed="x" * 200_000)
    assert built.log.read_text().strip() == "200000"
    assert run(tmp_path, "cat")[0].log.read_text() == ""
    assert str(built).startswith("build, 0.")


def test_the_output_is_plain_whatever_the_person_has_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """BUILDKIT_PROGRESS=tty would print moving lines."""
    monkeypatch.setenv("BUILDKIT_PROGRESS", "tty")
    built, _ = run(tmp_path, "sh", "-c", "echo $BUILDKIT_PROGRESS")
    assert built.log.read_text() == "plain\n"


def test_what_cannot_be_run_or_kept_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No program, no room for the log."""
    with pytest.raises(DesktopError, match="no-such-program is not installed"):
        run(tmp_path, "no-such-program")
    (tmp_path / "file").touch()
    with pytest.raises(DesktopError, match="cannot be written"):
        run(tmp_path / "file", "true")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert builder.logs() == tmp_path / "fleet/builds"


class Heard:
    """A watcher that keeps what it hears."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.steps: list[str] = []
        self.ended: list[str] = []

    def note(self, name: str, text: str) -> None:
        """See `builder.Watcher`."""
        self.notes.append(f"{name}: {text}")

    def step(self, name: str, title: str) -> None:
        """See `builder.Watcher`."""
        self.steps.append(f"{name} {title}")

    def built(self, name: str, built: builder.Built) -> None:
        """See `builder.Watcher`."""
        self.ended.append(f"{name} {built.summary}")


def command(reference: str, script: str, *, title: str = "build it") -> Command:
    return Command(title=title, argv=("sh", "-c", script), reference=reference, platform="linux/arm64")


def test_images_are_built_side_by_side_if_memory_allows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each waits for the other here; one after the other, neither would end."""
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    meet = "touch {0}; for _ in $(seq 100); do [ -e {1} ] && exit 0; sleep 0.1; done; exit 1"
    a, b = tmp_path / "a", tmp_path / "b"
    both = [command("a", meet.format(a, b)), command("b", meet.format(b, a))]
    heard = Heard()
    builder.run_all(both, watcher=heard, memory=2 * builder.MEMORY_OF_A_BUILD, folder=tmp_path / "logs")
    assert sorted(heard.ended) == ["a build", "b build"]


def test_commands_of_one_image_keep_their_order(tmp_path: Path) -> None:
    """It is pulled, and then named; after a failure nothing more begins."""
    heard = Heard()
    pull = [command("a", "sleep 0.1", title="pull x"), command("a", "true", title="name it a")]
    builder.run_all(pull, watcher=heard, memory=10**12, folder=tmp_path)
    assert heard.ended == ["a pull", "a name"]
    fails = [command("a", "exit 1"), command("a", "true"), command("b", "true")]
    with pytest.raises(DesktopError, match="build it failed"):
        builder.run_all(fails, watcher=heard, memory=0, folder=tmp_path)
    assert heard.ended == ["a pull", "a name"]


def test_platforms_of_one_image_are_pulled_in_turn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meanwhile its name is that of one platform: side by side, one of them would get the other's image."""
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    name, heard = tmp_path / "name", Heard()
    commands = [
        replace(one, turn="x")
        for platform in ("armv7", "arm64", "amd64")
        for one in (
            command(f"x-{platform}", f"echo {platform} >{name}; sleep 0.1", title="pull x"),
            command(f"x-{platform}", f"[ $(cat {name}) = {platform} ]", title="name it"),
        )
    ]
    builder.run_all(commands, watcher=heard, memory=10**12, folder=tmp_path / "logs")
    assert len(heard.ended) == 6
    (first, _) = build.pull("redis:7", "linux/arm64", policy="")
    (second, _) = build.pull("redis:7", "linux/arm/v7", policy="")
    assert (first.turn, second.turn) == ("redis:7", "redis:7")


def test_how_many_builds_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as images, processors and memory allow, and always one."""
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    one = builder.MEMORY_OF_A_BUILD
    found = [
        builder.at_once(images, memory=memory) for images, memory in ((3, 9 * one), (9, 9 * one), (9, one))
    ]
    assert found == [3, 4, 1]
    assert builder.at_once(9, memory=0) == 1
    (tmp_path / "meminfo").write_text("MemTotal:       8000 kB\nMemAvailable:   4000 kB\n")
    assert builder.free_memory(tmp_path / "meminfo") == 4096000
    assert builder.free_memory(tmp_path / "none") == 0


@pytest.fixture
def local(desktop: None) -> Iterator[str]:  # noqa: ARG001
    """An image that no registry has: nothing answers at its address."""
    for made in make_image(()):
        name = f"127.0.0.1:{free_port()}/{made}"
        subprocess.run(("docker", "tag", made, name), check=True)
        yield name
        subprocess.run(
            ("docker", "image", "rm", name, tagged_for(name, desktop_platform())),
            capture_output=True,
            check=False,
        )


def pulled(name: str, folder: Path, *, policy: str = "") -> Heard:
    """Run what brings an image of a service without ``build:`` here."""
    heard = Heard()
    commands = build.pull(name, desktop_platform(), policy=policy)
    builder.run_all(commands, watcher=heard, memory=0, folder=folder)
    return heard


def test_an_image_that_is_here_will_do_where_no_registry_answers(local: str, tmp_path: Path) -> None:
    """That is said, with its day; the next time, its own name for the platform is enough."""
    reference = tagged_for(local, desktop_platform())
    (note,) = pulled(local, tmp_path).notes
    assert note.startswith(f"{reference}: pull {local} for {desktop_platform()} failed")
    assert "connection refused" in note
    assert "that is here is used" in note
    subprocess.run(("docker", "image", "rm", local), check=True, capture_output=True)
    again = pulled(local, tmp_path)
    assert (len(again.notes), again.ended) == (1, [])


@pytest.mark.parametrize("policy", ["missing", "if_not_present", "never"])
def test_no_registry_is_asked_if_the_person_says_so(local: str, tmp_path: Path, policy: str) -> None:
    """Compose's ``pull_policy``."""
    heard = pulled(local, tmp_path, policy=policy)
    assert (heard.notes, heard.ended) == ([], [f"{tagged_for(local, desktop_platform())} tag"])


@pytest.mark.usefixtures("desktop")
@pytest.mark.parametrize("policy", ["", "missing", "never"])
def test_an_image_that_is_nowhere(tmp_path: Path, policy: str) -> None:
    """Then a pull that fails is a failure."""
    with pytest.raises(DesktopError, match="failed"):
        pulled(f"127.0.0.1:{free_port()}/nowhere:1", tmp_path, policy=policy)


def test_an_image_for_another_platform_will_not_do(local: str, tmp_path: Path) -> None:
    """It would be sent to robots that cannot run it."""
    commands = build.pull(local, "linux/riscv64", policy="")
    with pytest.raises(DesktopError, match="failed"):
        builder.run_all(commands, watcher=Heard(), memory=0, folder=tmp_path)
