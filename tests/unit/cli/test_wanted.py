from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.bundle.write import Writer
from fleet.cli import wanted
from fleet.cli.console import Screen
from fleet.errors import UsageError
from tests.support.bundles import ROBOT, bundle, release

if TYPE_CHECKING:
    from pathlib import Path


def test_a_bundle_has_what_its_robots_shall_run(tmp_path: Path) -> None:
    """With the seconds of the stack; no Docker and no project is asked. What it does not have is said."""
    Writer(tmp_path).write(bundle("pi1")[1])
    with wanted.opened([ROBOT], out_of=str(tmp_path), only="", screen=Screen()) as (_, releases):
        (one,) = releases["pi1"]
    assert (one.release.id, one.wait, one.settle, one.project) == (release().id, 180, 10, None)
    with wanted.opened([ROBOT], out_of=str(tmp_path), only="talker", screen=Screen()) as (_, releases):
        assert len(releases["pi1"]) == 1
    other = ROBOT.model_copy(update={"name": "pi9"})
    for robot, only, words in (
        (other, "", "nothing for pi9"),
        (ROBOT, "nav", "no stack nav for pi1; it has: talker"),
    ):
        with (
            pytest.raises(UsageError, match=words),
            wanted.opened([robot], out_of=str(tmp_path), only=only, screen=Screen()),
        ):
            pass
