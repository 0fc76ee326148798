from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.cli import dev
from fleet.errors import UsageError
from tests.support.samples import PI

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.project import Project


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project whose stack follows a folder."""
    (tmp_path / "src").mkdir()
    (tmp_path / "inventory.yaml").write_text("stack: compose.yaml\nrobots: {pi1: , pi2: }\n")
    (tmp_path / "compose.yaml").write_text(
        "name: nav\nservices: {node: {image: x, develop: {watch: [{action: sync, path: src, target: /app}]}}}\n"
    )
    return tmp_path


def test_a_dry_run_lists_what_is_followed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For each robot; no robot is asked."""
    code = dev.dev.body.__wrapped__(dry=True, inventory=str(folder / "inventory.yaml"))
    assert code == 0
    lines = [f"{name}: sync {folder}/src -> node:/app" for name in ("pi1", "pi2")]
    assert capsys.readouterr().out.splitlines() == lines


def test_json_is_for_the_end_only(folder: Path) -> None:
    """What goes on until Ctrl-C has no result."""
    with pytest.raises(UsageError, match="--json belongs to"):
        dev.dev.body.__wrapped__(json=True, inventory=str(folder / "inventory.yaml"))


def test_a_stack_without_the_section(folder: Path) -> None:
    """Told before any robot is reached, with the page that says how."""
    (folder / "compose.yaml").write_text("name: nav\nservices: {node: {image: x}}\n")
    with pytest.raises(UsageError) as caught:
        dev.dev.body.__wrapped__(inventory=str(folder / "inventory.yaml"))
    assert "pi1: no service of nav has `develop.watch`" in caught.value.what


def test_two_stacks_with_the_section(folder: Path) -> None:
    """One at a time: `--stack` says which."""
    text = (folder / "compose.yaml").read_text().replace("name: nav", "name: arm")
    (folder / "arm.yaml").write_text(text)
    (folder / "inventory.yaml").write_text("stack: [compose.yaml, arm.yaml]\nrobots: {pi1: }\n")
    with pytest.raises(UsageError) as caught:
        dev.dev.body.__wrapped__(dry=True, inventory=str(folder / "inventory.yaml"))
    assert caught.value.cure == "say which with --stack: nav, arm"
    assert dev.dev.body.__wrapped__(dry=True, stack="arm", inventory=str(folder / "inventory.yaml")) == 0


def test_the_end_of_a_robot_that_has_nothing(mine: Project) -> None:
    """Unchanged; a robot that is away is told as that."""
    done = mine.fleet("dev", "--end", "--hosts", PI.name)
    assert "unchanged" in done.out or "Docker" in done.out
    assert "Traceback" not in done.err
