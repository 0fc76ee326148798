from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError
from fleet.images import builder
from fleet.images.build import Command

if TYPE_CHECKING:
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
    built = builder.run(command, on_note=steps.append, on_step=steps.append, folder=folder)
    return built, steps


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
