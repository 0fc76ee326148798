"""An image with nothing but a shell and a few programs, for tests that run real containers."""

from __future__ import annotations

import io
import shutil
import subprocess
import tarfile
import uuid
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

BUSYBOX = Path(shutil.which("busybox") or "/bin/busybox")
"""A static one, which `make test` installs."""


def make_image(applets: tuple[str, ...]) -> Iterator[str]:
    """Yield an image whose only programs are some of busybox's and an empty `/app/node`; remove it at the end."""
    name = f"fleet-test-{uuid.uuid4().hex[:12]}:latest"
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(BUSYBOX.resolve(), "bin/busybox")
        for applet in applets:
            link = tarfile.TarInfo(f"bin/{applet}")
            link.type, link.linkname = tarfile.SYMTYPE, "busybox"
            archive.addfile(link)
        program = tarfile.TarInfo("app/node")
        archive.addfile(program)
    subprocess.run(("docker", "import", "-", name), input=buffer.getvalue(), check=True, capture_output=True)
    yield name
    subprocess.run(("docker", "image", "rm", "--force", name), check=True, capture_output=True)
