"""How does a connection go through a ProxyCommand of OpenSSH's configuration?

Paramiko's own class waits 100 ms for each short answer, spins when the command ends, and leaves it running.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import tempfile

_TAIL = 4096


class ProxySocket(socket.socket):
    """One end of a socket pair; the command has the other end. Closing it ends the command."""

    def __init__(self, command: str) -> None:
        near, far = socket.socketpair()
        super().__init__(fileno=near.detach())
        self.last_error = ""
        """The last line of the command's standard error, once closed."""
        # A file: a pipe that is not read would block the command.
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed with the socket
        with far:
            self._process = subprocess.Popen(
                # As OpenSSH runs it; in its own session, so that it cannot ask for a password on the terminal.
                ("/bin/sh", "-c", f"exec {command}"),
                stdin=far.fileno(),
                stdout=far.fileno(),
                stderr=self._errors,
                start_new_session=True,
            )

    def close(self) -> None:
        """Close this end, and kill the command with its child processes."""
        super().close()
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        with contextlib.suppress(ValueError, OSError):  # closed before
            size = os.fstat(self._errors.fileno()).st_size
            tail = os.pread(self._errors.fileno(), _TAIL, max(0, size - _TAIL))
            self.last_error = (tail.decode(errors="replace").strip().splitlines() or [""])[-1].strip()
            self._errors.close()
