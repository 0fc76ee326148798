from __future__ import annotations

import contextlib
import socket
import threading
import time
from typing import TYPE_CHECKING

from fleet.errors import Unreachable
from fleet.ssh import connect
from fleet.ssh.approach import Approach

if TYPE_CHECKING:
    from tests.support.sshd import Sshd, Sshds


def test_how_far_an_approach_has_come(sshds: Sshds, sshd: Sshd) -> None:
    """While nobody says a word the silence grows; a robot that has answered is not silent, however long it works."""
    approach = Approach()
    assert approach.silence == 0
    with socket.create_server(("127.0.0.1", 0)) as hole:
        silent = sshd.robot().model_copy(update={"port": hole.getsockname()[1]})

        def knock() -> None:
            with contextlib.suppress(Unreachable):
                connect.connect(silent, connect_timeout=1.5, config=sshds.config, approach=approach)

        trial = threading.Thread(target=knock)
        trial.start()
        end = time.monotonic() + 10
        while not 0.3 < approach.silence < 10:
            assert time.monotonic() < end
            time.sleep(0.01)
        trial.join()
    with connect.connect(sshd.robot(), config=sshds.config, approach=approach):
        assert approach.silence == 0
