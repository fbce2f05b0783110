"""Supervision of the guardian process, which parks the galvo if the process that drives it dies or stands still.

A guardian that dies, or does not answer, is replaced; while none is on guard the galvo must not move.
"""

from __future__ import annotations

import atexit
import json
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from typing import IO, TYPE_CHECKING, Any, Final, Self, cast

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.detached import DETACHED
from napari_elsplus.hardware.guardian.process import FAREWELL, HEARTBEAT, READY, STANDSTILL_S
from napari_elsplus.hardware.parking import call_each

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import ExitStack

    from napari_elsplus.hardware.parking import ParkState
    from napari_elsplus.hardware.protocols import Scanner
    from napari_elsplus.hardware.takeover import ParkOrder

COMMAND: Final = (sys.executable, "-m", "napari_elsplus.hardware.guardian.process")
POLL_S: Final = 0.05
"""Seconds between two checks of the guardian process; chosen: a small part of the 1 s in which it is replaced."""
SILENT_S: Final = 0.4
"""Seconds without answer to a heartbeat after which a guardian is replaced; chosen: twice the longest within 20 s on a
computer with seven times more work than processors (0.22 s)."""
REPLACE_WITHIN_S: Final = 0.85
"""Seconds from a guardian's last sign of life until another is ready; chosen: with the park that follows otherwise it
stays below 1 s."""
MAX_STEP_S: Final = 2 * POLL_S
"""Seconds that a check counts at most, so that a computer that stood still is no guardian that does not answer."""
START_TIMEOUT_S: Final = 30.0
"""Seconds for a guardian to be ready; chosen: ten times that of a busy computer."""
END_TIMEOUT_S: Final = 1.5
"""Seconds for a dismissed guardian to end, before it is killed; chosen: no call takes longer than 2 s."""
_ENDED_REMEDY: Final = "find out what ended it (memory, or another program), then start again"


class GuardianProcess:
    """One guardian process.

    Parameters
    ----------
    order : ParkOrder
        What it does if this process dies.

    Raises
    ------
    DeviceError
        If the system starts no process.
    """

    def __init__(self, order: ParkOrder) -> None:
        try:
            self._process = subprocess.Popen(
                COMMAND,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                **DETACHED,  # Ctrl-C and a closed terminal are for us, not for it
            )
        except OSError as error:
            raise DeviceError(f"the galvo's guardian did not start: {error}", "free memory, end processes") from error
        self._ready = threading.Event()
        self._answered = threading.Event()
        self._beats = threading.Event()
        self.silent_s = 0.0
        """Seconds since a heartbeat that it has not sent back."""
        self._listener = threading.Thread(target=self._read_answers, name="guardian's answers", daemon=True)
        self._listener.start()
        with suppress(OSError):  # seen by `wait_until_ready`
            self.send(json.dumps(asdict(order)))

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """True while it runs."""
        return self._process.poll() is None

    @property
    def took_over(self) -> bool:
        """True if it has parked and ended by itself, since this process stood still."""
        return self._process.poll() == 0

    def wait_until_ready(self, timeout_s: float) -> bool:
        """Wait until it is on guard, at most `timeout_s`; return False if it is not."""
        return self._answered.wait(timeout_s) and self._ready.is_set()

    @property
    def on_guard(self) -> bool:
        """True while it runs, is ready, and answers."""
        return self.alive and self.wait_until_ready(0) and self.silent_s < SILENT_S

    def beat(self, since_last_s: float) -> None:
        """Send a heartbeat if the last one was sent back, else count the seconds since this was last called."""
        if self._beats.is_set() or not self.silent_s:
            self._beats.clear()
            self.silent_s = 0.0
            with suppress(OSError):  # it died
                self.send(HEARTBEAT)
        self.silent_s += since_last_s

    def send(self, line: str) -> None:
        """Write a line to its pipe; raises OSError if it is no more."""
        pipe = cast("IO[str]", self._process.stdin)
        if pipe.closed:
            raise BrokenPipeError("the guardian was ended")
        pipe.write(line + "\n")
        pipe.flush()

    def end(self) -> None:
        """Dismiss it, and wait for its end."""
        with suppress(OSError):  # it is gone already
            self.send(FAREWELL)
        self.leave()
        self._listener.join(END_TIMEOUT_S)
        if self.alive:  # it stands still
            self.kill()
            self._listener.join(END_TIMEOUT_S)

    def kill(self) -> None:
        """End it without waiting, since a process that the system holds up ends later; it does not park."""
        self._process.kill()
        self.leave()

    def leave(self) -> None:
        """End its orders without a farewell, upon which it parks."""
        with suppress(OSError):
            cast("IO[str]", self._process.stdin).close()

    def _read_answers(self) -> None:
        with cast("IO[str]", self._process.stdout) as pipe:
            for line in pipe:
                if line.strip() == READY:
                    self._ready.set()
                self._answered.set()
                self._beats.set()
        self._answered.set()
        self._process.wait()  # no zombie is left


class Guardian:
    """Parks from another process if this one dies. A context manager: leaving it dismisses the guardian.

    The guardian process is polled, and replaced when it dies or does not answer. If a replacement is not ready in time,
    `lost` is called, which has to park, and starting one is tried again.

    Parameters
    ----------
    order : ParkOrder
        What to do if this process dies.
    lost : callable
        Called with a `DeviceError` while nothing is on guard.

    Raises
    ------
    DeviceError
        If the guardian does not start.
    """

    def __init__(self, order: ParkOrder, lost: Callable[[DeviceError], None] = lambda _: None) -> None:
        self._order, self._lost = order, lost
        self._lock = threading.Lock()
        self._dismissed = threading.Event()
        self._reports: list[DeviceError] = []
        self._subscribers: list[Callable[[DeviceError], None]] = []
        self._process = GuardianProcess(order)
        try:
            if not self._process.wait_until_ready(START_TIMEOUT_S):
                raise DeviceError("the galvo's guardian did not start", "see the messages above")
        except BaseException:  # also Ctrl-C: one without heartbeats would take the card over later
            self._process.kill()
            raise
        self._watch = threading.Thread(target=self._supervise, name="guardian watch", daemon=True)
        self._watch.start()

    @property
    def pid(self) -> int:
        """Process id of the guardian on guard."""
        return self._process.pid

    @property
    def on_guard(self) -> bool:
        """True while a guardian process waits."""
        return self._process.on_guard

    @property
    def order(self) -> ParkOrder:
        """Action of the guardian if this process dies."""
        return self._order

    @property
    def reports(self) -> tuple[DeviceError, ...]:
        """Events of the guardians, oldest first."""
        return tuple(self._reports)

    def check(self) -> None:
        """Raise while nothing is on guard: the galvo must not move then.

        Raises
        ------
        DeviceError
            If no other guardian comes in the time in which one that is gone is replaced.
        """
        end_s = time.monotonic() + REPLACE_WITHIN_S
        while not self.on_guard:
            if time.monotonic() > end_s:
                raise DeviceError("the galvo has no guardian", "start again when the faults say that one is on guard")
            time.sleep(POLL_S / 2)

    def on_report(self, callback: Callable[[DeviceError], None]) -> None:
        """Call `callback` with every later report, in the thread that supervises."""
        self._subscribers.append(callback)

    def revise(self, volts: float) -> None:
        """Park at another voltage, in volts, if this process dies; also for every replacement."""
        if volts == self._order.card.park_v:
            return
        with self._lock:
            self._order = replace(self._order, card=replace(self._order.card, park_v=volts))
            with suppress(OSError):  # it died: its replacement gets the order
                self._process.send(json.dumps(asdict(self._order)))

    def dismiss(self) -> None:
        """End the guardian: to be called when the galvo is parked, and confirmed to be."""
        if self._dismissed.is_set():
            return
        self._dismissed.set()
        if threading.current_thread() is not self._watch:
            self._watch.join()
        self._process.end()

    def hand_over(self) -> None:
        """Let it park now, while this process ends, which takes a while."""
        if not self._dismissed.is_set():
            self._dismissed.set()
            self._process.leave()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> Any:
        self.dismiss()

    def _supervise(self) -> None:
        checked_s = time.monotonic()
        while not self._dismissed.wait(POLL_S):
            now_s = time.monotonic()
            self._process.beat(min(now_s - checked_s, MAX_STEP_S))
            checked_s = now_s
            if not self._process.on_guard:
                if self._process.took_over:
                    self._lose(
                        f"this process stood still for {STANDSTILL_S:g} s, so its guardian parked the galvo",
                        "end what keeps the computer busy, or stopped this process, then start again",
                    )
                self._replace("did not answer" if self._process.alive else "had ended")

    def _lose(self, problem: str, remedy: str = _ENDED_REMEDY) -> None:
        """Report a problem, because of which the galvo has to be parked."""
        call_each((self._lost,), self._report(problem, remedy))

    def _replace(self, why: str) -> None:
        begun_s = time.monotonic() - self._process.silent_s
        self._process.kill()  # without a farewell, which one that stands still would not read
        parked = f"the galvo's guardian {why}, so the galvo was parked"
        try:
            with self._lock:
                new = self._process = GuardianProcess(self._order)
        except Exception:  # noqa: BLE001 - no process or thread can be started: the next check tries again
            self._lose(parked)
            self._dismissed.wait(REPLACE_WITHIN_S)
            return
        if new.wait_until_ready(max(0.0, begun_s + REPLACE_WITHIN_S - time.monotonic())):
            took_s = time.monotonic() - begun_s
            self._report(f"the galvo's guardian {why}; another was on guard {took_s:.1f} s later")
            return
        self._lose(parked)
        if new.wait_until_ready(START_TIMEOUT_S):
            self._report("another guardian is on guard; the galvo may be used again")

    def _report(self, problem: str, remedy: str = _ENDED_REMEDY) -> DeviceError:
        if self._reports and self._reports[-1].problem == problem:
            return self._reports[-1]
        report = DeviceError(problem, remedy)
        self._reports.append(report)
        call_each(tuple(self._subscribers), report)
        return report


def guard_scanner(scanner: Scanner, order: ParkOrder, held: ExitStack) -> Guardian:
    """Start the guardian of a scanner, which is dismissed when `held` is closed and the galvo is parked.

    Parameters
    ----------
    scanner : Scanner
        Open; closed before its guardian is dismissed.
    order : ParkOrder
        Action of the guardian if this process dies, at the voltage at which the scanner parks.
    held : contextlib.ExitStack
        Closed with the rig.

    Raises
    ------
    DeviceError
        If the guardian does not start.
    """
    order = replace(order, card=replace(order.card, park_v=scanner.park_v))
    if isinstance(scanner, DaqScanner):
        guardian = Guardian(order, scanner.interrupt)
        scanner.check_guarded = guardian.check
    else:
        guardian = Guardian(order, partial(_park, scanner))
    scanner.on_park_state(lambda _: guardian.revise(scanner.park_v))

    def end() -> None:
        try:
            scanner.close()
        finally:  # it may be interrupted; parking goes on
            when_parked(scanner, guardian.dismiss)
            if not scanner.park_state.parked:
                atexit.register(guardian.hand_over)

    held.callback(end)
    return guardian


def _park(scanner: Scanner, _: DeviceError) -> None:
    with suppress(DeviceError):  # `park_state` shows it, and the scanner tries again
        scanner.park()


def when_parked(scanner: Scanner, act: Callable[[], object]) -> None:
    """Act once a scanner is parked: now, or after the attempt that succeeds."""
    done = threading.Lock()

    def react(state: ParkState) -> None:
        if state.parked and done.acquire(blocking=False):
            act()

    scanner.on_park_state(react)
    react(scanner.park_state)
