"""How is time used in which a verb waits for another program?"""

from __future__ import annotations

import contextlib
import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

T = TypeVar("T")


@contextlib.contextmanager
def beside(work: Callable[[], T]) -> Generator[Callable[[], T]]:
    """Begin work in a thread; yield a function that waits for its result, or raises what it raised.

    Nobody need ask for the result; what can be closed is closed then.
    """
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as problem:  # noqa: BLE001  raised where the result is needed
            future.set_exception(problem)

    # A daemon: after Ctrl-C nobody waits for it.
    threading.Thread(target=run, daemon=True).start()
    asked = False

    def result() -> T:
        nonlocal asked
        asked = True
        return future.result()

    yield result
    if not asked and not future.exception():
        unused = future.result()
        if isinstance(unused, contextlib.AbstractContextManager):
            unused.__exit__(None, None, None)
