from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.support.sshd import Sshd, Sshds

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

# Examples are checked, not timed: on a computer that does something else too, any of them may take long.
settings.register_profile("fleet", deadline=None)
settings.load_profile("fleet")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what a test wants to be seen, also where it ran in another process."""
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if name == "shown":
                terminalreporter.write_line(f"{report.nodeid}: {value}")


@pytest.fixture
def sshds(tmp_path: Path) -> Iterator[Sshds]:
    """Starts real SSH servers."""
    servers = Sshds(tmp_path)
    yield servers
    servers.stop()


@pytest.fixture
def sshd(sshds: Sshds) -> Sshd:
    """A real SSH server, its host key recorded."""
    return sshds.start()
