"""Parking as a verified state: unknown -> parking -> parked, or not parked, which is retried without end.

The galvo counts as parked only after the card has confirmed it. An attempt that fails is repeated; after some failures
each attempt begins with a reset of the card. On NI's M, C and X Series a reset puts the analog outputs at 0 V, on E and
S Series they keep their voltage, so the laser line may stand on the bundle from the reset to the write that follows it:
the laser is switched off before, the write follows at once, and the time between is reported.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from napari_elsplus.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

_log = logging.getLogger(__name__)
News = TypeVar("News")

RETRY_S: Final = 0.02
"""Seconds between two attempts; chosen: some task set-up times of the driver, small against the 0.5 s allowed."""
MANY_ATTEMPTS: Final = 50
"""Attempts after which they become rarer; chosen: a second of refusals is no short error."""
RETRY_LATER_S: Final = 0.1
"""Seconds between later attempts; chosen: a card that accepts again is parked within 0.5 s all the same."""
RESET_AFTER: Final = 2
"""Failed attempts before the first that begins with a reset; chosen: a single error of the driver is made up for."""
RESET_INTERVAL_S: Final = 0.2
"""Seconds between two resets; chosen: a reset takes some 10 ms to 100 ms, and what it may expose has to stay short."""
LASER_OFF: Final = "NOT PARKED: switch the laser off"


class ParkStage(StrEnum):
    """Stage of parking."""

    UNKNOWN = "unknown"
    """Nothing was commanded yet."""
    DRIVEN = "driven"
    """A hold or a scan moves the galvo, as commanded."""
    PARKING = "parking"
    """An attempt runs; no earlier one has failed."""
    PARKED = "parked"
    """The card has confirmed the parking voltage."""
    NOT_PARKED = "not parked"
    """Attempts have failed and go on."""


@dataclass(frozen=True, slots=True)
class ParkState:
    """State of the galvo with respect to its parking position.

    Parameters
    ----------
    stage : ParkStage
        Where parking stands.
    problem : str
        Why the last attempt failed; of a galvo that is parked, why the laser's line was not switched off.
    attempts, resets : int
        Attempts since parking was commanded, and resets of the card among them.
    reset_s : float
        Seconds from those resets to the next voltage that was put out, in which the output may have been at its
        power-up voltage.
    read_back_v : float, optional
        Voltage that the card measured on its output; None where it cannot.

    Examples
    --------
    >>> print(ParkState(ParkStage.NOT_PARKED, "card Dev1: the card is in use by another program").message)
    NOT PARKED: switch the laser off (card Dev1: the card is in use by another program; parking is retried)
    """

    stage: ParkStage = ParkStage.UNKNOWN
    problem: str = ""
    attempts: int = 0
    resets: int = 0
    reset_s: float = 0.0
    read_back_v: float | None = None

    @property
    def parked(self) -> bool:
        """True if the card has confirmed the parking voltage."""
        return self.stage is ParkStage.PARKED

    @property
    def retry_s(self) -> float:
        """Seconds until the next attempt."""
        return RETRY_S if self.attempts < MANY_ATTEMPTS else RETRY_LATER_S

    @property
    def message(self) -> str:
        """Instruction while the galvo is not parked, or the laser on; else how long a reset may have lit the bundle."""
        if self.stage is ParkStage.NOT_PARKED:
            return f"{LASER_OFF} ({self.problem}; parking is retried)"
        if self.parked and self.problem:
            return f"parked, but the laser's line was not switched off ({self.problem})"
        if self.resets:
            return f"the card was reset {self.resets} times: up to {self.reset_s * 1e3:.0f} ms at its power-up voltage"
        return ""


class ParkingOutput(Protocol):
    """Operations of an analog output that parking needs; every method raises `DeviceError` where the card refuses."""

    def laser_off(self) -> None:
        """Switch the laser off, where a line is wired to it."""

    def clear(self) -> None:
        """Stop and delete what drives the output."""

    def put(self, volts: float) -> None:
        """Put a voltage out, in volts."""

    def confirm(self, volts: float) -> float | None:
        """Return the voltage read back, None where the card cannot; raise if the output is not at `volts`."""

    def reset(self) -> None:
        """Reset the card, which aborts every task on it, of whatever program."""


class Parking:
    """The state machine: attempts to park an output, and their state, which others read and subscribe to.

    Attempts are made by one thread at a time; state and subscriptions may be used by any.

    Parameters
    ----------
    output : ParkingOutput
        The output.
    volts : float
        Parking voltage.
    now_s : callable
        Clock.
    """

    def __init__(self, output: ParkingOutput, volts: float, now_s: Callable[[], float] = time.perf_counter) -> None:
        self.output, self.volts, self._now_s = output, volts, now_s
        self._changed = threading.Condition()
        self._state = ParkState()
        self._subscribers: list[Callable[[ParkState], None]] = []
        self._last_reset_s = -RESET_INTERVAL_S
        self._power_up_s: float | None = None
        """When the first reset began after which nothing has been put out yet."""

    @property
    def state(self) -> ParkState:
        """The state now."""
        return self._state

    def subscribe(self, callback: Callable[[ParkState], None]) -> Callable[[], None]:
        """Call `callback` with every new state, in the thread that parks; return a function that ends it."""
        with self._changed:
            self._subscribers.append(callback)

        def end() -> None:
            with self._changed:
                if callback in self._subscribers:
                    self._subscribers.remove(callback)

        return end

    def retarget(self, volts: float) -> None:
        """Set the parking voltage of later attempts, in volts; a galvo that is parked elsewhere is parked no more."""
        moves = volts != self.volts
        self.volts = volts
        self._change(lambda state: ParkState(ParkStage.PARKING) if moves and state.parked else state)

    def begin(self, stage: ParkStage) -> None:
        """Enter a stage: ``DRIVEN`` before a hold or scan, ``PARKING`` when parking is commanded."""
        goes_on = (ParkStage.PARKING, ParkStage.NOT_PARKED) if stage is ParkStage.PARKING else ()
        self._change(lambda state: None if state.stage in goes_on else ParkState(stage))

    def alarm(self, problem: str) -> None:
        """Enter ``NOT_PARKED`` with a problem while an attempt does not come to an end."""

        def alarmed(state: ParkState) -> ParkState | None:
            ongoing = state.stage is ParkStage.PARKING
            return replace(state, stage=ParkStage.NOT_PARKED, problem=problem) if ongoing else None

        self._change(alarmed)

    def revoke(self, problem: str) -> None:
        """Enter ``NOT_PARKED`` with a problem found while it was ``PARKED``."""
        self._change(lambda state: ParkState(ParkStage.NOT_PARKED, problem) if state.parked else None)

    def wait(self, timeout_s: float) -> ParkState:
        """Wait until the galvo is parked; return the state, ``NOT_PARKED`` if it is not within `timeout_s`."""
        with self._changed:
            if self._changed.wait_for(lambda: self._state.parked, timeout_s):
                return self._state
        self.alarm("the card has not confirmed it")
        return self._state

    def attempt(self, *, stuck: bool = False) -> ParkState:
        """Try once to park; return the state, ``PARKED`` or ``NOT_PARKED``. Never raises, whatever the output does.

        Parameters
        ----------
        stuck : bool
            Calls to the card may not return before a reset, which comes first.
        """
        self.begin(ParkStage.PARKING)
        before, volts = self._state, self.volts
        resets, reset_s = before.resets, before.reset_s
        laser, problem = "" if stuck else self._try(self.output.laser_off), ""
        now_s = self._now_s()
        resets_now = (stuck or before.attempts >= RESET_AFTER) and now_s - self._last_reset_s >= RESET_INTERVAL_S
        if resets_now:
            self._last_reset_s = now_s
            problem = self._try(self.output.reset)
            if not problem:
                resets += 1
                self._power_up_s = now_s if self._power_up_s is None else self._power_up_s
        elif before.attempts:
            problem = self._try(self.output.clear)
        try:
            self.output.put(volts)
            if self._power_up_s is not None:
                reset_s, self._power_up_s = reset_s + self._now_s() - self._power_up_s, None
            if resets_now:
                laser = self._try(self.output.laser_off)  # a reset sets digital lines to their power-up state
            read_back_v = self.output.confirm(volts)
        except Exception as error:  # noqa: BLE001 - the next attempt has to come, also after a defect or without memory
            failed = _problem(error)
            problem = problem or laser or failed if before.attempts else failed
            state = ParkState(ParkStage.NOT_PARKED, problem, before.attempts + 1, resets, reset_s)
        else:
            stage = ParkStage.PARKED if volts == self.volts else ParkStage.PARKING  # it may have been changed meanwhile
            state = ParkState(stage, laser, before.attempts + 1, resets, reset_s, read_back_v)
        self._change(lambda _: state)
        return state

    @staticmethod
    def _try(step: Callable[[], None]) -> str:
        """Return the error of a step, empty if there is none: the write decides."""
        try:
            step()
        except Exception as error:  # noqa: BLE001 - see `attempt`
            return _problem(error)
        return ""

    def _change(self, change: Callable[[ParkState], ParkState | None]) -> None:
        """Enter the state that follows from the one now, if any does, before any other thread enters one."""
        with self._changed:
            state = change(self._state)
            if state is None:
                return
            self._state = state
            subscribers = tuple(self._subscribers)
            self._changed.notify_all()
        call_each(subscribers, state)


def _problem(error: Exception) -> str:
    return str(error) if isinstance(error, DeviceError) else f"{type(error).__name__}: {error}"


def call_each(subscribers: Iterable[Callable[[News], None]], news: News) -> None:
    """Call all `subscribers` with `news`; one that fails stops neither the others nor what keeps the galvo safe."""
    for callback in subscribers:
        try:
            callback(news)
        except Exception:  # noqa: BLE001 - see above
            _log.exception("a subscriber failed")
