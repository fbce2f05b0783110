"""Context managers that close what they hold, and signals that end a program let them."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from collections.abc import Iterator

_ENDING: Final = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a program; Windows has only the first, and ends programs without it."""


class ClosedOnExit:
    """Base of classes with a method ``close``: a context manager that calls it on every way out."""

    def close(self) -> None:
        """Release what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()


@contextmanager
def unwound_by_signals() -> Iterator[None]:
    """Within the context, let SIGTERM and SIGHUP end the program by SystemExit, so that what it holds is closed.

    Signals that the program ignores or handles otherwise are left alone, and so are all of them outside the main
    thread. One that arrives while the program unwinds is ignored.
    """
    main = threading.current_thread() is threading.main_thread()
    handled = [number for number in _ENDING if main and signal.getsignal(number) is signal.SIG_DFL]

    def end(number: int, _: Any) -> None:
        for other in handled:
            signal.signal(other, signal.SIG_IGN)
        raise SystemExit(128 + number)

    for number in handled:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)
