"""A process with a single task: park the galvo if the process that drives it dies or stands still.

``kill -9``, a crash in a driver or the system's memory killer leave no time for clean-up, and a process that is stopped
or hangs checks nothing any more, while the card goes on sweeping the laser, or leaves it on one line of tissue. The
guardian process waits on a pipe for heartbeats; when they end without a farewell, it parks, without end until the card
confirms it, and ends.

Run as ``python -m napari_elsplus.hardware.guardian.process``.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Final

from napari_elsplus.hardware.takeover import ParkOrder

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TextIO

    from napari_elsplus.hardware.parking import ParkState

READY: Final = "ready"
FAREWELL: Final = "farewell"
HEARTBEAT: Final = "heartbeat"
"""Messages of the pipes; a heartbeat is sent back."""
STANDSTILL_S: Final = 2.0
"""Seconds without a message after which a process stands still; chosen: ten times the longest between two heartbeats
within 20 s on a computer with seven times more work than processors, and as long as any command may take."""
POLL_S: Final = 0.5
"""Seconds that a wait for a message counts at most, so that a computer that stood still is no silence."""
TERMINAL_S: Final = 1.0
"""Seconds for the terminal to take the last message; chosen: it may have been stopped by Ctrl-S."""


def guard(orders: TextIO, answers: TextIO, report: Callable[[ParkState], None] = lambda _: None) -> None:
    """Read park orders, and carry out the last one if messages end, or stay away, without a farewell.

    Parameters
    ----------
    orders : file
        One order as JSON per line.
    answers : file
        Receives `READY`.
    report : callable
        Called with every stage of parking.

    Raises
    ------
    DeviceError
        If the driver cannot be reached when it comes on guard.
    """
    lines: SimpleQueue[str] = SimpleQueue()
    Thread(target=_read, args=(orders, lines), name="orders", daemon=True).start()
    first = lines.get()
    if not first.endswith("\n"):  # the process ended before it had given an order: it has moved nothing
        return
    order = ParkOrder.of(json.loads(first))
    order.preload()
    _answer(answers, READY)
    while (line := _next(lines)).endswith("\n"):  # one that was cut off was never given
        if line.strip() == FAREWELL:
            return
        if line.strip() == HEARTBEAT:
            _answer(answers, HEARTBEAT)
        else:
            order = ParkOrder.of(json.loads(line))
    order.take_over(report)


def _answer(answers: TextIO, message: str) -> None:
    with suppress(OSError):  # the process at the other end is dead, also before this one is ready: the orders end
        answers.write(message + "\n")
        answers.flush()


def _read(orders: TextIO, lines: SimpleQueue[str]) -> None:
    """Pass every line on, and an empty one at the end."""
    line = "\n"
    while line:
        line = orders.readline()
        lines.put(line)


def _next(lines: SimpleQueue[str]) -> str:
    """Return the next line; an empty one if none comes for `STANDSTILL_S`."""
    for _ in range(round(STANDSTILL_S / POLL_S)):
        with suppress(Empty):
            return lines.get(timeout=POLL_S)
    return ""


def _print_to_terminal(state: ParkState) -> None:
    if text := state.message or ("the galvo was parked by its guardian" if state.parked else ""):
        with suppress(OSError):  # there may be no terminal any more
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()


def main() -> int:
    """Guard the process at the other end of standard input; return the exit code: 0 after a farewell, or parked."""
    for name in ("SIGTERM", "SIGHUP", "SIGINT"):  # sent to all at once, as at a logout, when it is needed most
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    printed: list[Future[None]] = []
    printer = ThreadPoolExecutor(1, "terminal")  # a terminal that takes nothing does not stop parking
    try:
        guard(sys.stdin, sys.stdout, lambda state: printed.append(printer.submit(_print_to_terminal, state)))
    except Exception:  # noqa: BLE001 - ends with the reason, as it would by itself
        sys.excepthook(*sys.exc_info())
        return 1
    wait(printed, TERMINAL_S)
    return 0


if __name__ == "__main__":
    os._exit(main())  # not waiting for the threads that read orders, and write to the terminal
