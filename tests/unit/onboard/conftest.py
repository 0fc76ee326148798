from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from tests.support.robot_shell import EACH_SHELL

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(params=EACH_SHELL)
def home(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A robot's home, where ``sh`` is each of the shells that are here."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/sh").symlink_to(shutil.which(request.param) or "")
    (tmp_path / "home").mkdir()
    return tmp_path / "home"
