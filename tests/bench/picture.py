"""Draw docs/demo.svg: what verbs print on a terminal, from a real run of them. `make picture`, with a fleet that runs."""

from __future__ import annotations

import io
import os
import pty
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
    said = bytearray()

    def read(descriptor: int) -> bytes:
        data = os.read(descriptor, 65536)
        said.extend(data)
        return b""

    os.environ.update(COLUMNS=str(COLUMNS), LINES="40", TERM="xterm-256color")
    code = os.waitstatus_to_exitcode(pty.spawn(argv, read))
    if code:
        sys.exit(f"{' '.join(argv)} ended with {code}: {said.decode(errors='replace')}")
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
