"""How is a table shown whose rows arrive one after the other?

On a terminal it is drawn again and again. Elsewhere rows are printed as they arrive, and never changed: the first ones
after a moment, so that a small fleet is one table with fitting columns.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType

    Rows = Sequence[Sequence[tuple[str, str]]]

FIRST, NEXT = 1.0, 0.5
"""Seconds until the first rows are printed, and between two looks for more."""


class GrowingTable:
    """Print the rows that ``rows`` has more than before, until the ``with`` block ends. It only ever adds rows at the end.

    ``show`` prints some rows; its second argument says whether they are the first ones.
    """

    def __init__(self, rows: Callable[[], Rows], show: Callable[[Rows, bool], None]) -> None:
        self._rows = rows
        self._show = show
        self._shown = 0
        self._over = threading.Event()
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._grow, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        if self._failed:
            raise self._failed
        if kind is None:
            self._print(at_least_headings=True)

    def _grow(self) -> None:
        try:
            over = self._over.wait(FIRST)
            while not over:
                self._print()
                over = self._over.wait(NEXT)
        except BaseException as problem:  # noqa: BLE001  raised in the thread that can show it
            self._failed = problem

    def _print(self, *, at_least_headings: bool = False) -> None:
        rows = self._rows()
        if len(rows) > self._shown or (at_least_headings and not self._shown):
            self._show(rows[self._shown :], not self._shown)
            self._shown = len(rows)
