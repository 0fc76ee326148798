"""A USB stick: a FAT32 file system in a file, put into this computer or into a virtual Pi, and pulled out of it.

fusefat serves it, so no kernel module is needed, and "pulled out" is the end of its process: whoever reads or writes gets an
error. Needs root, dosfstools and fusefat.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from tests.support.sd_card import run

if TYPE_CHECKING:
    from pathlib import Path

    from tests.lab.conftest import Pi

PLACE = "/mnt/stick"

_INTO = """
import ctypes, os, sys
call = ctypes.CDLL(None, use_errno=True).syscall
def do(*arguments):
    if (result := call(*arguments)) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result
tree = do(428, -100, sys.argv[1].encode(), 1)
do(308 if os.uname().machine == "x86_64" else 268, os.open(f"/proc/{sys.argv[2]}/ns/mnt", os.O_RDONLY), 0)
do(429, tree, b"", -100, sys.argv[3].encode(), 4)
"""
"""open_tree(OPEN_TREE_CLONE), setns, and move_mount(MOVE_MOUNT_F_EMPTY_PATH) in another mount namespace: linux/mount.h."""


class UsbStick:
    """A stick of ``size``. ``folder`` is where it is on this computer while it is put in."""

    def __init__(self, directory: Path, *, size: str = "600M") -> None:
        self._file = directory / "stick.img"
        self.folder = directory / "STICK"
        self.folder.mkdir()
        run("truncate", "--size", size, str(self._file))
        run("mkfs.vfat", "-F", "32", str(self._file))
        self._server: subprocess.Popen[bytes] | None = None
        self._pi: Pi | None = None

    def put_in(self, pi: Pi | None = None) -> None:
        """Put it into this computer, and into a Pi too."""
        options = "rw+,allow_other,uid=1000,gid=1000,umask=022"
        command = ("fusefat", "-f", "-o", options, str(self._file), str(self.folder))
        self._server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 20
        while not os.path.ismount(self.folder):
            assert time.monotonic() < deadline, "fusefat does not serve the stick"
            time.sleep(0.05)
        if pi:
            pi.exec("mkdir", "-p", PLACE)
            process = run("docker", "inspect", "--format", "{{.State.Pid}}", pi.container)
            run(sys.executable, "-c", _INTO, str(self.folder), process, PLACE)
            self._pi = pi

    def pull_out(self) -> None:
        """While somebody is at work with it; if it is not in, nothing happens."""
        if self._server:
            self._server.kill()
            self._server.wait()
            self._unmount("--lazy")

    def eject(self) -> None:
        """When everything has been written."""
        assert self._server
        server = self._server
        self._unmount()
        server.wait(20)

    def _unmount(self, *flags: str) -> None:
        if self._pi:
            self._pi.exec("umount", *flags, PLACE)
            self._pi = None
        run("umount", *flags, str(self.folder))
        self._server = None
