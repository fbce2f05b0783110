"""Calls to a card, all made by one thread; a second thread resets the card around a call that does not return."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Final, TypeVar

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.daq.errors import translate_daq_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_log = logging.getLogger(__name__)
Result = TypeVar("Result")

CHECK_EVERY_S: Final = 0.02
"""Seconds between two checks of a call that has not returned; chosen: a small part of `STUCK_S`."""
MAX_STEP_S: Final = 0.05
"""Seconds that a check counts at most, so that a computer that stood still is no call that does not return."""
STUCK_S: Final = 0.8
"""Seconds after which a call counts as stuck; chosen: above a call's time on a busy computer, below the 2 s in which
every command has to end."""
GIVE_UP_S: Final = 1.6
"""Seconds after which a command is given up whose call not even a reset has ended; chosen: a reset takes some 0.1 s."""
RESET_WAIT_S: Final = 1.0
"""Seconds for which a call that returned after all waits for the reset around it; chosen: ten times a reset's."""


class Calls:
    """Notes when calls to a card begin and return, and keeps a reset apart from them.

    A call that returns while the card is being reset waits for the end of the reset, and raises: its tasks are gone.

    Parameters
    ----------
    device : str
        Name of the card, for messages.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._depth = 0
        self._steps = 0
        self._reset_over = threading.Event()
        self._reset_over.set()
        self._tasks_lost = False

    @property
    def pending(self) -> int:
        """Number of the call that has not returned; 0 if there is none."""
        return self._steps if self._depth else 0

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        """Make calls within the context; may be nested. Errors of the driver become a `DeviceError`."""
        self._steps += 1
        self._depth += 1
        try:
            with translate_daq_errors(self._device):
                yield
        finally:
            self._depth -= 1
            self._steps += 1
            self._reset_over.wait(RESET_WAIT_S)
            if self._tasks_lost and not self._depth:
                self._tasks_lost = False
                raise DeviceError(f"card {self._device}: it was reset around a call that did not return", "start again")

    @contextlib.contextmanager
    def resetting_around(self, call: int) -> Iterator[bool]:
        """Keep the calls that return meanwhile waiting; yield True if the `call` of that number is still pending."""
        self._reset_over.clear()
        try:
            stuck = self.pending == call
            self._tasks_lost |= stuck
            yield stuck
        finally:
            self._reset_over.set()


class Patience:
    """Counts the seconds for which the same call has been pending.

    Parameters
    ----------
    calls : Calls
        Of the card.
    """

    def __init__(self, calls: Calls) -> None:
        self._calls, self._call, self.waited_s = calls, 0, 0.0

    def wait(self, event: threading.Event) -> bool:
        """Wait for an event until the next check of the pending call; return True if it was set."""
        begun_s = time.perf_counter()
        if event.wait(CHECK_EVERY_S):
            return True
        call = self._calls.pending
        step_s = min(time.perf_counter() - begun_s, MAX_STEP_S)
        self.waited_s = self.waited_s + step_s if call and call == self._call else 0.0
        self._call = call
        return False


class CardThread:
    """The thread that calls a card: commands in the order in which they were given, and a routine between them.

    Parameters
    ----------
    calls : Calls
        Of the card.
    routine : callable
        Called between commands; returns the seconds until it is due again, None to end the thread.
    failed : callable
        Receives whatever the routine raises, and returns the seconds until it is due again. Must not raise.
    end : callable
        Called last.
    go_around : callable
        Called in a second thread with the number of a call that has not returned for `STUCK_S`; returns True if the
        card was parked.
    """

    def __init__(
        self,
        calls: Calls,
        routine: Callable[[], float | None],
        failed: Callable[[BaseException], float],
        end: Callable[[], None],
        go_around: Callable[[int], bool],
    ) -> None:
        self._calls, self._routine, self._failed, self._end, self._go_around = calls, routine, failed, end, go_around
        self._wake, self._ended = threading.Event(), threading.Event()
        self._commands: list[tuple[Future[Any], Callable[[], Any]]] = []
        self._thread = threading.Thread(target=self._run, name="galvo card", daemon=True)
        self._watch = threading.Thread(target=self._watch_calls, name="galvo watch", daemon=True)

    def start(self) -> None:
        """Start both threads."""
        self._thread.start()
        self._watch.start()

    def execute(self, act: Callable[[], Result]) -> Result:
        """Call a function in the card's thread, and return its result or raise its error.

        Parameters
        ----------
        act : callable
            Called without arguments, after the commands given before it.

        Raises
        ------
        DeviceError
            If a call to the card does not return, whatever is done about it.
        """
        if threading.current_thread() is self._thread:
            return act()
        command, ended = Future[Result](), threading.Event()
        command.add_done_callback(lambda _: ended.set())
        self._commands.append((command, act))
        self.wake()
        patience = Patience(self._calls)
        while not patience.wait(ended):
            if self._ended.is_set() and not ended.is_set():
                raise DeviceError("the galvo was closed", "open the rig again")
            if patience.waited_s > GIVE_UP_S:
                command.cancel()
                raise DeviceError("a call to the card does not return", "check its cable, then open the rig again")
        return command.result()

    def wake(self) -> None:
        """Let the routine be due now."""
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of both threads, at most `timeout_s`, from any thread but the card's own."""
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout_s)
            self._watch.join(timeout_s)

    def _run(self) -> None:
        try:
            while (pause_s := self._take_turn()) is not None:
                self._wake.wait(pause_s)
                self._wake.clear()
            self._end()
        finally:
            self._ended.set()

    def _take_turn(self) -> float | None:
        """Carry out the commands, then the routine; return the seconds until it is due again, None at the end."""
        try:
            while self._commands:
                self._carry_out(*self._commands.pop(0))
            return self._routine()
        except BaseException as error:  # noqa: BLE001 - no other thread would park
            return self._failed(error)

    @staticmethod
    def _carry_out(command: Future[Any], act: Callable[[], Any]) -> None:
        if command.set_running_or_notify_cancel():  # else it was given up
            try:
                command.set_result(act())
            except BaseException as error:  # noqa: BLE001 - raised where the command was given
                command.set_exception(error)

    def _watch_calls(self) -> None:
        patience, parked = Patience(self._calls), 0
        while not patience.wait(self._ended):
            call = self._calls.pending
            try:
                if patience.waited_s > STUCK_S and call != parked and self._go_around(call):
                    parked = call
            except Exception:  # noqa: BLE001 - tried again at the next check
                _log.exception("a call that does not return was not gone around")
