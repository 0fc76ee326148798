from __future__ import annotations

import pytest

from fleet.errors import NotReady
from fleet.provision import sudo
from fleet.robot.facts import Facts, Login


def test_sudo_is_told_not_to_ask() -> None:
    """A prompt for a password would hang."""
    assert sudo.as_root(Facts(login=Login(sudo="free")), "date") == ("sudo", "-n", "date")


def test_root_is_root() -> None:
    """Where the login is root, sudo may not even be there."""
    assert sudo.as_root(Facts(login=Login(sudo="root")), "date") == ("date",)


def test_the_line_for_sudoers_is_spelt_out() -> None:
    """With the login's own name, ready to be copied."""
    with pytest.raises(NotReady, match=r"sudo asks tim .*010_tim-nopasswd.*: tim ALL=\(ALL\) NOPASSWD: ALL$"):
        sudo.check(Facts(login=Login(sudo="password", name="tim")))


def test_those_who_may_pass() -> None:
    """Nothing is asked of root, nor of whom sudo does not ask."""
    sudo.check(Facts(login=Login(sudo="root")))
    sudo.check(Facts(login=Login(sudo="free")))
