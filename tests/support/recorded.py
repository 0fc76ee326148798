"""Datagrams of real DDS programs, as they arrived at a listener."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "rtps"
NAMES = sorted(path.stem for path in FOLDER.glob("*.txt"))
ROBOT = "10.77.0.2"


def datagrams(name: str) -> list[bytes]:
    """The datagrams of one recording, in their order."""
    lines = (FOLDER / f"{name}.txt").read_text(encoding="ascii").splitlines()
    return [bytes.fromhex(line) for line in lines if not line.startswith("#")]
