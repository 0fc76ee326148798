from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support import project
from tests.support.sshd import Sshds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.project import Project


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory, desktop: None) -> Iterator[Project]:  # noqa: ARG001
    """A project with two robots and one that is away. Tests that share it change nothing in it."""
    sshds = Sshds(tmp_path_factory.mktemp("project"))
    yield project.make(sshds, "pi1", "pi2")
    sshds.stop()


@pytest.fixture
def own(sshds: Sshds) -> Project:
    """A project of the test's own, with one robot and one that is away."""
    return project.make(sshds, "pi1")
