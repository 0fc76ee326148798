from __future__ import annotations

import contextlib
import os
import subprocess
import time

import pytest

from fleet.plan import compose_steps


@pytest.mark.parametrize(("beats", "lives"), [(True, True), (False, False)])
def test_what_nobody_listens_to_any_more_ends(beats: bool, lives: bool) -> None:
    """A lost link closes nothing: the command goes on for as long as signs of life come, and no longer."""
    _, dash_c, script, *rest = compose_steps.until_closed(("sleep", "30"))
    argv = ("sh", dash_c, script.replace("timeout 45", "timeout 1"), *rest)
    with subprocess.Popen(argv, stdin=subprocess.PIPE, start_new_session=True) as process:
        assert process.stdin
        for _ in range(12):
            time.sleep(0.25)
            if beats:
                process.stdin.write(b".")
                process.stdin.flush()
        assert (process.poll() is None) == lives
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 9)


@pytest.mark.parametrize("code", [0, 17])
def test_a_command_that_ends_by_itself_gives_its_exit_code(code: int) -> None:
    """The watcher does not keep it, nor change its code."""
    argv = compose_steps.until_closed(("sh", "-c", f"exit {code}"))
    with subprocess.Popen(argv, stdin=subprocess.PIPE) as process:
        assert process.wait(timeout=20) == code
