"""How far has an attempt to connect come? So a pool can tell a robot that works from one that says nothing."""

from __future__ import annotations

import time
from typing import Protocol


class Speaker(Protocol):
    """The part of ``paramiko.Transport`` that is used here: its other end's first words, empty before they come."""

    remote_version: str


class Approach:
    """How far an attempt to connect has come; another thread reads it."""

    def __init__(self) -> None:
        self._since: float | None = None
        self._transport: Speaker | None = None

    @property
    def silence(self) -> float:
        """Seconds that the robot has been asked for an answer and has not said a word; 0 if it has, or is not asked."""
        since, transport = self._since, self._transport
        if since is None or (transport and transport.remote_version):
            return 0.0
        return time.monotonic() - since

    def ask(self) -> None:
        """Note that the robot is asked now."""
        self._since, self._transport = time.monotonic(), None

    def listen(self, transport: Speaker) -> None:
        """Note by which transport the robot's first words will come."""
        self._transport = transport

    def end(self) -> None:
        """Note that nothing is waited for."""
        self._since = None
