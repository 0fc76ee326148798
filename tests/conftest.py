from __future__ import annotations

import json
import os
import shutil
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.support import fault_report
from tests.support.sshd import SSHD, Sshd, Sshds

if TYPE_CHECKING:
    from collections.abc import Iterator

# Examples are checked, not timed: on a computer that does something else too, any of them may take long.
settings.register_profile("fleet", deadline=None)
settings.load_profile("fleet")

DESKTOP_PROGRAMS = {SSHD, *filter(None, map(shutil.which, ("docker", "dockerd", "ip", "nsenter", "unshare")))}
DOCKER_SOCKETS = {"/var/run/docker.sock", "/run/docker.sock"}


class _Guard:
    """Refuse real servers to the tests without the mark `desktop`: `make check` must run without them.

    An audit hook sees every program that this process starts and every socket that it connects.
    """

    def __init__(self) -> None:
        self.test = ""

    def __call__(self, event: str, arguments: tuple[object, ...]) -> None:
        if not self.test or event not in {"subprocess.Popen", "socket.connect"}:
            return
        if event == "socket.connect":
            refused = arguments[1] in DOCKER_SOCKETS if isinstance(arguments[1], str) else False
        else:
            program = os.fsdecode(arguments[0])  # type: ignore[arg-type]
            refused = (shutil.which(program) or program) in DESKTOP_PROGRAMS
        if refused:
            raise RuntimeError(f"{self.test} uses {arguments[:2]}: its fixture must request `desktop`")


_guard = _Guard()
sys.addaudithook(_guard)


def pytest_configure() -> None:
    """Restore the signals that tests send to programs: `make test &` has Ctrl-C ignored, `nohup make test` a hang-up."""
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, usual)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that use the fixture `desktop`, themselves or through another fixture."""
    for item in items:
        if "desktop" in item.fixturenames:  # type: ignore[attr-defined]
            item.add_marker(pytest.mark.desktop)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Tell the guard which test runs."""
    marked = any(item.iter_markers("desktop")) or any(item.iter_markers("lab"))
    _guard.test = "" if marked else item.nodeid
    try:
        return (yield)
    finally:
        _guard.test = ""


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what a test wants to be seen, also where it ran in another process; the faults as a table."""
    faults = []
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if name == "shown":
                terminalreporter.write_line(f"{report.nodeid}: {value}")
            if name == "fault":
                faults.append(fault_report.Fault(**json.loads(str(value))))
    if faults:
        terminalreporter.write_line(fault_report.table(faults))
    failed = len(terminalreporter.getreports("failed"))
    if page := os.environ.get("FLEET_FAULTS_PAGE"):
        Path(page).write_text(fault_report.page(faults, failed=failed), encoding="utf-8")


@pytest.fixture(scope="session")
def desktop() -> None:
    """Mark a test as one that needs more than Python: this computer's Docker or sshd, root, or a long time.

    Such a test is left out of `make check`. A fixture that starts a server requests this one, so that each test which
    uses it is marked.
    """


@pytest.fixture
def sshds(tmp_path: Path, desktop: None) -> Iterator[Sshds]:  # noqa: ARG001  it marks the test
    """Starts real SSH servers."""
    servers = Sshds(tmp_path)
    yield servers
    servers.stop()


@pytest.fixture
def sshd(sshds: Sshds) -> Sshd:
    """A real SSH server, its host key recorded."""
    return sshds.start()
