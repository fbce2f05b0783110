"""Context managers that close what they hold, and signals that end a program let them."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from collections.abc import Iterator

_ENDING: Final = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a program; Windows has only the first, and ends programs without it."""
_AGAIN_S: Final = 0.02
"""Seconds after which a signal is handled again, its exception discarded; chosen: a callback has returned by then."""


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
def unwound_by_signals(*, interrupts: bool = False) -> Iterator[None]:
    """Within the context, let SIGTERM and SIGHUP end the program by SystemExit, so that what it holds is closed.

    Signals that the program ignores or handles otherwise are left alone, and so are all of them outside the main
    thread. One that arrives while the program unwinds is ignored. One that arrives in a callback or a finalizer, where
    Python discards exceptions, is handled again after it.

    Parameters
    ----------
    interrupts : bool
        Ctrl-C, too, which raises KeyboardInterrupt as ever, is ignored from then on: for programs that end by it, not
        for sessions that go on.
    """
    main = threading.current_thread() is threading.main_thread()
    before = {number: signal.getsignal(number) for number in (*_ENDING, signal.SIGINT)}
    untouched = {signal.SIG_DFL, *((signal.default_int_handler,) if interrupts else ())}
    handled = [number for number, handler in before.items() if main and handler in untouched]

    restored = list(handled)
    raised: dict[int, BaseException] = {}
    report = sys.unraisablehook

    def end(number: int, _: Any) -> None:
        if interrupts:
            restored.clear()
        for other in handled:
            signal.signal(other, signal.SIG_IGN)
        raised[number] = KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)
        raise raised[number]

    def end_again(discarded: Any) -> None:
        number = next((one for one, error in raised.items() if error is discarded.exc_value), None)
        if number is None:
            report(discarded)
            return
        signal.signal(number, end)
        again = threading.Timer(_AGAIN_S, _send_to_main_thread, (number,))
        again.daemon = True
        again.start()

    for number in handled:
        signal.signal(number, end)
    sys.unraisablehook = end_again
    try:
        yield
    finally:
        sys.unraisablehook = report
        for number in restored:
            signal.signal(number, before[number])


def _send_to_main_thread(number: int) -> None:
    if sys.platform == "win32":
        _thread.interrupt_main(signal.Signals(number))
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, number)  # ends what it waits for, too
