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
_AGAIN_S: Final = 0.5
"""Seconds after which a signal is sent again, as its exception may be lost; chosen: to be waited for, and seldom."""


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
    thread. One that arrives while the program unwinds is ignored. One whose exception is discarded, by Python in
    callbacks and finalizers or by a library that catches all, comes again until the program unwinds.

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

    raised: list[BaseException] = []
    report = sys.unraisablehook
    ended, sending = threading.Event(), threading.Lock()

    def end(number: int, _: Any) -> None:
        if raised and _is_handled(raised[-1]):
            return
        if not raised:
            _thread.start_new_thread(insist, (number,))
        raised.append(KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number))
        raise raised[-1]

    def insist(number: int) -> None:
        while not ended.wait(_AGAIN_S):
            with sending:
                if not ended.is_set():
                    _send_to_main_thread(number)

    def report_others(discarded: Any) -> None:
        if discarded.exc_value not in raised:
            report(discarded)

    for number in handled:
        signal.signal(number, end)
    sys.unraisablehook = report_others
    try:
        yield
    finally:
        with sending:
            ended.set()
        sys.unraisablehook = report
        for number in handled:
            signal.signal(number, signal.SIG_IGN if raised and interrupts else before[number])


def _is_handled(error: BaseException) -> bool:
    """Return True if this thread handles an error, or one that came meanwhile: what it leaves is being closed."""
    handled = sys.exc_info()[1]
    while handled is not None and handled is not error:
        handled = handled.__context__
    return handled is not None


def _send_to_main_thread(number: int) -> None:
    if sys.platform == "win32":
        _thread.interrupt_main(signal.Signals(number))
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, number)  # ends what it waits for, too
