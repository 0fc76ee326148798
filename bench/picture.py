"""Draw docs/demo.svg: what verbs print on a terminal, from a real run of them. `make picture`, with a fleet that runs."""

from __future__ import annotations

import contextlib
import io
import os
import pty
import subprocess
import sys

from rich.console import Console
from rich.text import Text

from bench.pairs import ROOT

VERBS = (
    ("fab", "ship", "--hosts", "fleet"),
    ("fab", "status"),
    ("fab", "listen", "--count", "2"),
    ("fab", "history", "--tail", "2"),
)
COLUMNS = 112


def shown(argv: tuple[str, ...]) -> str:
    """What a command prints on a terminal, control sequences and all, with the lines it has overdrawn left out."""
    ours, its = pty.openpty()
    environment = {**os.environ, "COLUMNS": str(COLUMNS), "LINES": "40", "TERM": "xterm-256color"}
    said = bytearray()
    with subprocess.Popen(argv, stdin=its, stdout=its, stderr=its, env=environment) as process:
        os.close(its)
        with contextlib.suppress(OSError):  # how Linux says that the other end is closed
            while piece := os.read(ours, 65536):
                said += piece
    os.close(ours)
    if process.returncode:
        sys.exit(f"{' '.join(argv)} ended with {process.returncode}: {said.decode(errors='replace')}")
    text = said.decode().replace("\r\n", "\n")
    return text.rpartition("\x1b[?25h")[2].lstrip("\r\n") if "\x1b[?25h" in text else text


def main() -> None:
    """Run the verbs and write the picture."""
    console = Console(record=True, width=COLUMNS, file=io.StringIO())
    for argv in VERBS:
        console.print(Text.assemble(("$ ", "bold green"), (" ".join(argv), "bold")))
        console.print(Text.from_ansi(shown(argv)))
    console.save_svg(str(ROOT / "docs" / "demo.svg"), title="three robots")


if __name__ == "__main__":
    main()
