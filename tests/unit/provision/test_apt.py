from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.provision import apt
from fleet.robot.facts import Facts, Login, Packages

if TYPE_CHECKING:
    from fleet.robot.facts import Sudo


@pytest.mark.parametrize(
    ("packages", "sudo", "installs"),
    [
        ((), "free", True),
        ((), "root", True),
        (("zstd",), "free", False),
        ((), "password", False),
        ((), "none", False),
    ],
)
def test_zstd_is_installed_if_the_login_may(packages: tuple[str, ...], sudo: Sudo, installs: bool) -> None:
    """A robot whose login is not allowed to is not refused: its layers are uploaded whole."""
    steps = apt.zstd(
        facts=Facts(packages=Packages(installed=packages), login=Login(sudo=sudo)), bounds=apt.Bounds()
    )
    assert [step.argv[-1] for step in steps] == ["zstd"] * installs
